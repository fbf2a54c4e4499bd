"""What a person asks of an environment at work: to wait, to end an episode, to begin it again."""

from __future__ import annotations

import copy
import logging
import time
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv, TransformedEnv

from rrl.keys import SUCCESS
from rrl.robot import RobotFault
from rrl.signals import held_back
from rrl.slot_masks import truncate

__all__ = ["Request", "Requests", "has_content", "stand_still", "stop_of"]

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
    ends the episode; asked for before an episode's first step, it ends none. To repeat a start the
    environment has to save its state, as :class:`torch.nn.Module` does. A pause lets a simulation
    wait; a robot, which cannot, is stopped, and its episode is cut short.

    Attributes:
        check: Raises if the run was asked to end; called by whatever waits for a robot or tries it
            again.
    """

    def __init__(self) -> None:
        self.paused = False
        self.check: Callable[[], None] = lambda: None
        self._judged: bool | None = None
        self._repeats = False
        self._start: dict[str, Any] | None = None  # the repeating environment before its last reset

    def take(self, request: Request) -> None:
        """Note a request."""
        if request in (Request.PAUSE, Request.GO_ON):
            self.paused = request is Request.PAUSE
        elif request is Request.REPEAT:
            self._repeats = True
        else:
            self._judged = request is Request.SUCCEEDED

    def before_step(self, env: EnvBase, is_first: bool) -> bool:
        """Let an environment stand still if there is a pause.

        Args:
            env: A bare environment.
            is_first: Whether an episode begins: no judgement before it was meant for it.

        Returns:
            Whether it is a robot: it is stopped then, and waits before its next reset.
        """
        is_robot = False
        if self.paused:
            if (stop := stop_of(env)) is None:
                self._wait()
            else:
                stop()
                is_robot = True
        if is_first and self._judged is not None:
            log.warning("a judgement came when no episode was under way: nothing is judged")
            self._judged = None
        return is_robot

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
        self.cut(next_td)
        if (entry := next_td.get(SUCCESS, None)) is not None:
            next_td.set(SUCCESS, torch.full_like(entry, judged))

    @staticmethod
    def cut(next_td: TensorDictBase) -> None:
        """End the episode of ``next_td``, which is truncated; its ``success`` stays."""
        truncate(next_td, torch.ones(*next_td.batch_size, 1, dtype=torch.bool))

    def before_reset(self, env: EnvBase, repeats: bool) -> None:
        """Wait while there is a pause, with a robot that stands still.

        Raises whatever :attr:`check` does, if a robot's pause ends because the run does.

        Args:
            env: A bare environment.
            repeats: Whether it is put back to where its last episode began, if that was asked for.
                Of those that share the requests one may.
        """
        if self.paused:
            stop = stop_of(env)
            if stop is None:
                self._wait()
            else:
                stop()
                self._wait()
                self.check()  # whoever has the run end may have a hand where the robot would go
        if repeats:
            self._repeat_start(env)

    def _repeat_start(self, env: EnvBase) -> None:
        asked, self._repeats = self._repeats, False
        if (slots := env.batch_size.numel()) > 1:
            if asked:
                log.warning(
                    "to repeat a start needs one environment at a time, these are %d: it is not "
                    "repeated",
                    slots,
                )
        elif not asked:
            self._start = _saved(env)
        elif self._start is None:
            log.warning("this environment does not save its state: its next start is another one")
        else:
            env.load_state_dict(copy.deepcopy(self._start))

    def _wait(self) -> None:
        while self.paused:
            time.sleep(POLL)


def stop_of(env: EnvBase) -> Callable[[], object] | None:
    """Return what has an environment's robot stand still, its method ``stop``; None if it has none.

    Copies in processes of their own are simulations: a robot is driven by one process.
    """
    bare = env
    while isinstance(bare, TransformedEnv):
        bare = bare.base_env
    if isinstance(bare, ParallelEnv) or (isinstance(bare, SerialEnv) and bare.is_closed):
        return None  # copies that were not made yet have no attributes
    stop = getattr(env, "stop", None)
    return stop if callable(stop) else None


def stand_still(env: EnvBase) -> None:
    """Have an environment's robot stand still, if it is one and answers."""
    if (stop := stop_of(env)) is not None:
        try:
            with held_back():
                stop()
        except RobotFault as fault:  # it stops by itself: nobody commands it any more
            log.debug("stop: %s", fault)


def _saved(env: EnvBase) -> dict[str, Any] | None:
    """Return an environment's state; None if it has none, not yet, or one that is not copied."""
    try:
        state = dict(env.state_dict())
        return copy.deepcopy(state) if has_content(state) else None
    except Exception as error:  # asked for by nobody so far: no reason to warn
        log.debug("no start to repeat: %s", error)
        return None


def has_content(state: Any) -> bool:
    """Return whether there is anything in a state but empty mappings and None."""
    if isinstance(state, Mapping):
        return any(map(has_content, state.values()))
    return state is not None
