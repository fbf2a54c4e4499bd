"""What a person asks of an environment at work: to wait, to end an episode, to begin it again."""

from __future__ import annotations

import copy
import logging
import time
from collections.abc import Mapping
from enum import Enum
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from rrl.keys import SUCCESS

__all__ = ["Request", "Requests"]

POLL = 0.02
"""Seconds between two looks whether a pause is over."""

log = logging.getLogger(__name__)


class Request(Enum):
    """What can be asked for."""

    PAUSE = "pause"
    GO_ON = "go on"
    SUCCEEDED = "this one succeeded"
    FAILED = "this one failed"
    REPEAT = "repeat the same start"


class Requests:
    """What has been asked for and not been done yet. Any thread may ask; plain values change hands.

    An environment asks :meth:`before_step`, :meth:`judge` and :meth:`before_reset`. A judgement
    ends the episode; asked for in one episode, it does not reach the next. To repeat a start the
    environment has to save its state, as :class:`torch.nn.Module` does.
    """

    def __init__(self) -> None:
        self.paused = False
        self._judged: bool | None = None
        self._repeats = False
        self._start: dict[str, Any] | None = None  # the environment before its last reset

    def take(self, request: Request) -> None:
        """Note a request."""
        if request in (Request.PAUSE, Request.GO_ON):
            self.paused = request is Request.PAUSE
        elif request is Request.REPEAT:
            self._repeats = True
        else:
            self._judged = request is Request.SUCCEEDED

    def before_step(self) -> None:
        """Wait while there is a pause."""
        while self.paused:
            time.sleep(POLL)

    def judge(self, next_td: TensorDictBase) -> None:
        """End the episode as a person has judged it; leave ``next_td`` alone where nobody has.

        Args:
            next_td: What a step of the environment led to; its ``done``, ``truncated`` and
                ``success`` are replaced.
        """
        judged, self._judged = self._judged, None
        if judged is None:
            return
        if next_td.batch_size.numel() > 1:
            log.warning(
                "a judgement needs one environment at a time, these are %d: nothing is judged",
                next_td.batch_size.numel(),
            )
            return
        for key, value in (("done", True), ("truncated", True), (SUCCESS, judged)):
            if (entry := next_td.get(key, None)) is not None:
                next_td.set(key, torch.full_like(entry, value))

    def before_reset(self, env: EnvBase) -> None:
        """Put the bare environment back to where its last episode began, if that was asked for."""
        self._judged, repeats, self._repeats = None, self._repeats, False
        if env.batch_size.numel() > 1:
            return
        if not repeats:
            self._start = _saved(env)
        elif self._start is None:
            log.warning("this environment does not save its state: its next start is another one")
        else:
            env.load_state_dict(copy.deepcopy(self._start))


def _saved(env: EnvBase) -> dict[str, Any] | None:
    """Return an environment's state; None if it has none, or none before its first step."""
    try:
        state = dict(env.state_dict())
    except Exception as error:  # asked for by nobody so far: no reason to warn
        log.debug("no start to repeat: %s", error)
        return None
    return copy.deepcopy(state) if _has_content(state) else None


def _has_content(state: Any) -> bool:
    if isinstance(state, Mapping):
        return any(map(_has_content, state.values()))
    return state is not None
