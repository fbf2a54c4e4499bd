"""Parts of a run that need help to give and take back their state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tensordict import TensorDictBase
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv

from rrl.slot_random import seed_env


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


class EpisodeInProgress:
    """The environment in the middle of an episode: the bare environment, its transforms, what the policy sees next.

    A transformed environment's ``state_dict`` covers its transforms only, and TorchRL's collector saves neither the
    environment's state nor the observation it is about to act on. An environment whose ``state_dict`` is empty
    (hardware, Gymnasium) cannot go on where it was; :attr:`continues` is then false and :meth:`start_anew` begins the
    next episode.
    """

    def __init__(self, env: TransformedEnv, collector: Collector) -> None:
        self.env, self.collector = env, collector

    @property
    def continues(self) -> bool:
        """Whether the bare environment has a state to save."""
        return _has_content(self.env.base_env.state_dict())

    def state_dict(self) -> dict[str, Any]:
        """States of the base environment and the transforms, and the collector's current entries by flattened key."""
        return {
            "base": dict(self.env.base_env.state_dict()),
            "transforms": dict(self.env.transform.state_dict()),
            "carrier": {str(key): value for key, value in self._carrier.flatten_keys("/").items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore all three, or the transforms alone where the environment has no state."""
        self.env.transform.load_state_dict(state["transforms"])
        if self.continues:
            self.env.base_env.load_state_dict(state["base"])
            for key, value in state["carrier"].items():
                self._carrier.set(tuple(key.split("/")), value)

    def start_anew(self, seed: int) -> None:
        """Begin the next episode; what is random about it comes from ``seed``."""
        seed_env(self.env.base_env, seed)
        self.collector.reset()

    @property
    def _carrier(self) -> TensorDictBase:
        return self.collector._carrier


def _has_content(state: Any) -> bool:
    return (
        any(map(_has_content, state.values())) if isinstance(state, Mapping) else state is not None
    )
