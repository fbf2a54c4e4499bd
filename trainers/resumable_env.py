"""An environment at work: a person may pause, judge and stop it, and it goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from rrl.keys import DIVERGED, METRICS, REWARD_TERMS, SAFETY, SUCCESS
from rrl.slot_masks import resets_itself

from .requests import Requests
from .workers import WorkerErrors

__all__ = ["ResumableEnv"]

DEAD = "Cannot proceed", "At least one process failed"
"""How TorchRL begins to say that a worker has died: while it waits for it, or before it asks it."""


REPORTED = (SUCCESS, DIVERGED, METRICS, SAFETY, REWARD_TERMS)


class ResumableEnv(TransformedEnv):
    """A transformed environment that knows what the policy sees next, and can begin with it.

    Attributes:
        next_input: Root entries after the last reset or step, resets of ended episodes included.
    """

    next_input: TensorDictBase
    worker_errors: WorkerErrors | None = None
    requests: Requests | None = None
    _repeats = True
    _last: TensorDictBase
    _reported: TensorDictBase
    _is_new: bool
    _seconds: dict[str, float]
    is_cut_short: bool = False
    """Whether a pause has stopped the robot in the middle of the last episode."""

    def listen_to(self, requests: Requests, *, repeats: bool = True) -> None:
        """Do what a person asks for; ``repeats`` says whether a start may be repeated."""
        self.__dict__["requests"], self.__dict__["_repeats"] = requests, repeats

    def lap(self) -> dict[str, float]:
        """Return the seconds of steps, ``robot``, and of resets since the last time."""
        seconds: dict[str, float] = self.__dict__.pop("_seconds", {})
        return seconds

    @contextmanager
    def _timed(self, part: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            seconds = self.__dict__.setdefault("_seconds", {"robot": 0.0, "reset": 0.0})
            seconds[part] += time.perf_counter() - start

    def begin_with(self, entries: TensorDictBase) -> None:
        """Have the next reset return these entries."""
        self._begin = entries

    def reset(self, tensordict: TensorDictBase | None = None, **arguments: Any) -> TensorDictBase:
        """Reset the environment, or return what :meth:`begin_with` was given."""
        if self.requests is not None:
            self.requests.before_reset(self.base_env, self._repeats)
        self.__dict__.update(is_cut_short=False, _is_new=True)
        with self._timed("reset"), self._explaining():
            self.next_input = super().reset(tensordict, **arguments)
        begin: TensorDictBase | None = self.__dict__.pop("_begin", None)
        if begin is not None:
            self.next_input = begin
        self.__dict__["_last"] = self.next_input.copy()  # whoever acts adds to what it was given
        return self.next_input

    def step_and_maybe_reset(
        self, tensordict: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        """Step, and reset what has ended."""
        with self._explaining():
            out, self.next_input = super().step_and_maybe_reset(tensordict)
        if (reported := self.__dict__.pop("_reported", None)) is not None:
            out["next"].update(reported)
        return out, self.next_input

    def step(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Step, once a pause is over; a person's judgement may end the episode.

        A robot is stopped by a pause, and not stepped: the episode ends where it was.
        """
        if self.requests is not None:
            is_first = self.__dict__.pop("_is_new", False)
            self.__dict__["is_cut_short"] = self.requests.before_step(self.base_env, is_first)
        if self.is_cut_short:
            out = tensordict.set("next", self._as_it_was())
        else:
            with self._timed("robot"), self._explaining():
                out = super().step(tensordict)
        self.__dict__["_last"] = out["next"]
        if self.requests is not None:
            self.requests.judge(out["next"])
            if self.is_cut_short:
                self.requests.cut(out["next"])
        if resets_itself(self):
            # TorchRL puts NaN in the place of all that an episode's last step shows.
            self.__dict__["_reported"] = out["next"].select(*REPORTED, strict=False).copy()
        return out

    def _as_it_was(self) -> TensorDictBase:
        """Return what the step before led to; after a reset there was no reward yet: 0."""
        entries: TensorDictBase = self.full_reward_spec.zero().update(self._last.clone())
        return entries

    @contextmanager
    def _explaining(self) -> Iterator[None]:
        try:
            yield
        except RuntimeError as error:
            errors = self.__dict__.get("worker_errors")
            if errors is None or not str(error).startswith(DEAD):
                raise
            raise errors.explained(error) from error
