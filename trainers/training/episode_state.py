"""The training environment in the middle of an episode, saved and restored."""

from __future__ import annotations

import copy
import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase, TransformedEnv

from rrl.keys import ACTION
from rrl.slot_random import seed_env

from ..requests import has_content
from ..resumable_env import ResumableEnv
from ..storage.plain_state import entries
from .torchrl_collector import Collector

log = logging.getLogger(__name__)


class EpisodeInProgress:
    """The bare environment, its transforms, and what the policy sees next.

    A transformed environment's ``state_dict`` covers its transforms only, and TorchRL's collector
    saves neither the environment's state nor the observation that it is about to act on. Whether
    the environment can go on from its state is tried once, before anything is collected. One that
    cannot (hardware, Gymnasium) begins a new episode with :meth:`start_anew`.
    """

    def __init__(self, env: ResumableEnv, collector: Collector) -> None:
        self.env, self.collector = env, collector
        self._can_continue: bool | None = None

    @property
    def can_continue(self) -> bool:
        """Whether the bare environment goes on from a restored state as if nothing had happened."""
        if self._can_continue is None:
            tried, self._can_continue = goes_on_from_its_state(
                self.env.base_env, self.env.next_input
            )
            if tried and not self._can_continue:
                self.collector.reset()  # the trial has moved the environment
        return self._can_continue

    def state_dict(self) -> dict[str, Any]:
        """Return the states of environment and transforms, and what the policy sees next."""
        state: dict[str, Any] = {
            "can_continue": self.can_continue,
            "transforms": dict(self.env.transform.state_dict()),
        }
        if self.can_continue:
            state["base"] = dict(self.env.base_env.state_dict())
            state["next_input"] = entries(self.env.next_input)
        return state

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`; the transforms alone where the environment cannot go on."""
        self._can_continue = bool(state["can_continue"])
        if self._can_continue:
            self.env.begin_with(TensorDict(state["next_input"], self.env.batch_size))
            self.collector.reset()
            _put_back(self.env.base_env, state["base"])
        self.env.transform.load_state_dict(state["transforms"])

    def start_anew(self, seed: int) -> None:
        """Begin the next episode; what is random about it comes from ``seed``."""
        seed_env(self.env, seed)
        self.collector.reset()


def goes_on_from_its_state(env: EnvBase, root: TensorDictBase) -> tuple[bool, bool]:
    """Return whether it was tried, and whether an environment put back is where it was.

    It is if it makes the same step again, and then reports the same state. The action is zero, or
    nearest to it: whatever the environment drives, it stays near where it is.

    Nothing is tried on an environment that has no episode's state to give: one whose ``state_dict``
    is empty, or holds nothing but its modules' parameters and buffers.

    Args:
        env: The bare environment.
        root: What its last reset or step gave; transforms of its own read it with the action.
    """
    try:
        state = dict(env.state_dict())
    except Exception as error:  # parts of TorchRL's have none before their first step
        _say_why(error)
        return False, False
    modules = {name for name, _ in env.named_parameters()} | {n for n, _ in env.named_buffers()}
    if not has_content({key: value for key, value in state.items() if key not in modules}):
        return False, False
    spec = env.full_action_spec[ACTION]
    action = spec.project(spec.zero())  # zero may be out of bounds
    root = root if env.device is None else root.to(env.device)

    def step() -> TensorDictBase:
        return env.step(root.clone().set(ACTION, action))["next"].clone()

    try:
        before = copy.deepcopy(state)
        first = step()
        _put_back(env, state)
        second = step()
        _put_back(env, before)
        after = env.state_dict()
    except Exception as error:  # no way back, whatever the reason
        _say_why(error)
        return True, False
    return True, _equal(first.to_dict(), second.to_dict()) and _equal(dict(after), before)


def _say_why(error: Exception) -> None:
    log.warning(
        "the environment's state cannot be restored (%s: %s); a resumed run begins an episode",
        type(error).__name__,
        error,
    )


def _put_back(env: EnvBase, state: Mapping[str, Any]) -> None:
    """Load an environment's state; the next step of a ``ParallelEnv`` then waits for its workers.

    TorchRL 0.14 leaves the flags raised by which its workers say that they have loaded. The next
    step would take them for its own, and return what the workers wrote before.
    """
    env.load_state_dict(state)
    while isinstance(env, TransformedEnv):
        env = env.base_env
    flags = vars(env).get("_shm_done_flags", ())
    for worker in range(len(flags)):
        flags[worker] = 0


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(_equal(value, b[key]) for key, value in a.items())
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(_equal, a, b))
    if isinstance(a, (torch.Tensor, np.ndarray)):
        return np.array_equal(
            np.asarray(a), np.asarray(b), equal_nan=np.asarray(a).dtype.kind in "fc"
        )
    if a is None or isinstance(a, (bool, int, float, str, bytes)):
        return bool(a == b)
    return type(a) is type(b)  # cannot be saved, and the first checkpoint will say so
