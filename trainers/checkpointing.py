"""Saving a run and taking it up again.

Layout, below the run's directory::

    config.yaml                      the resolved configuration
    metrics.csv                      every metric so far
    wandb_id                         identity of the W&B run
    checkpoints/
        checkpoint_000000005000/     written under a temporary name, then renamed
            manifest...              TorchRL's manifest with components and metadata
            agent/                   parameters, targets, optimisers, update counter
            exploration/             noise processes and their generators
            environment/             physics, episode, transforms, their generators
            collector/               the observation that the next action answers
            replay/                  transitions of all seeds, and the cursor
            sampler/                 generators of replay sampling
            progress/                counters
            rng/                     global generators of Python, NumPy and torch

Loading executes no code: tensors are read as weights only, the rest is JSON and memory maps.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tensordict import TensorDict
from torchrl.checkpoint import (
    Checkpoint,
    CheckpointAdapter,
    CheckpointRotation,
    GlobalRNGState,
    StateDictCheckpointAdapter,
)
from torchrl.data import TensorDictReplayBuffer
from torchrl.envs import TransformedEnv

from .layout import CHECKPOINTS


class Holder:
    """Gives a plain dictionary the ``state_dict`` interface of a checkpoint's component."""

    def __init__(self, state: dict[str, Any]) -> None:
        self.state = state

    def state_dict(self) -> dict[str, Any]:
        """The dictionary."""
        return self.state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Replace the dictionary's content."""
        self.state.clear()
        self.state.update(state)


class EnvironmentState:
    """The transforms of an environment, and the bare environment where it has a state of its own to give.

    A transformed environment's ``state_dict`` covers its transforms only. An environment without a ``state_dict``
    (hardware, Gymnasium) starts a new episode after loading; everything else goes on.
    """

    def __init__(self, env: TransformedEnv) -> None:
        self.env = env

    def state_dict(self) -> dict[str, Any]:
        """State of the base environment and of the transforms."""
        return {
            "base": dict(self.env.base_env.state_dict()),
            "transforms": dict(self.env.transform.state_dict()),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore both."""
        self.env.base_env.load_state_dict(state["base"])
        self.env.transform.load_state_dict(state["transforms"])


class ReplayContent:
    """A replay buffer's transitions and cursor: what is filled, not the whole capacity."""

    def __init__(self, replay: TensorDictReplayBuffer) -> None:
        self.replay = replay

    def state_dict(self) -> dict[str, Any]:
        """The transitions by flattened key, and where the next one goes."""
        writer = self.replay.writer.state_dict()
        if not len(self.replay):
            return {"transitions": {}, "writer": writer}
        flat = self.replay.storage[: len(self.replay)].flatten_keys("/")
        return {"transitions": {str(k): v for k, v in flat.items()}, "writer": writer}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Put the transitions back in their places."""
        flat = state["transitions"]
        if flat:
            transitions = TensorDict(flat, [len(next(iter(flat.values())))]).unflatten_keys("/")
            self.replay.storage.set(range(len(transitions)), transitions)
        self.replay.writer.load_state_dict(state["writer"])


class Checkpoints:
    """The checkpoints of one run.

    Args:
        run_dir: the run's directory.
        keep: how many checkpoints stay.
        components: what to save, by name; anything with ``state_dict`` or ``dump``.

    """

    def __init__(self, run_dir: Path, keep: int, components: Mapping[str, Any]) -> None:
        self._checkpoint = Checkpoint()
        for name, component in {**components, "rng": GlobalRNGState()}.items():
            self._checkpoint.register(name, component, adapter=_adapter())
        self._rotation = CheckpointRotation(run_dir / CHECKPOINTS, keep_last=keep)

    def save(self, env_steps: int) -> Path:
        """Write a checkpoint and drop the ones beyond ``keep``."""
        return self._rotation.save(self._checkpoint, step=env_steps, metadata={"env_steps": env_steps})

    def load_latest(self) -> Path:
        """Restore every component from the newest checkpoint.

        Raises:
            FileNotFoundError: if the run has none.

        """
        path = latest(self._rotation.directory.parent)
        self._checkpoint.load(path)
        return path


def latest(run_dir: Path) -> Path:
    """The newest checkpoint of a run.

    Raises:
        FileNotFoundError: if the run has none; the message says where it was looked for.

    """
    folder = run_dir / CHECKPOINTS
    found = sorted(p for p in folder.glob("checkpoint*") if p.is_dir()) if folder.is_dir() else []
    if not found:
        raise FileNotFoundError(f"no checkpoint in {folder}: expected the directory of a run that saved at least one")
    return found[-1]


def load_agent(run_dir: Path, agent: Any) -> Path:
    """Restore only the agent from a run's newest checkpoint, for evaluation."""
    path = latest(run_dir)
    checkpoint = Checkpoint().register("agent", agent, adapter=_adapter())
    checkpoint.load(path, components=["agent"])
    return path


def _adapter() -> CheckpointAdapter:
    return StateDictCheckpointAdapter("torch")  # one file a component, loaded as weights only
