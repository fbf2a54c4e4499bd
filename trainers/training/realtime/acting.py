"""The loop that does not wait: one environment, stepped at its control period."""

from __future__ import annotations

import logging
import time
from itertools import chain

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torchrl.envs.utils import step_mdp

from rrl.keys import ACTION, BASE_ACTION
from rrl.pace import Pace
from rrl.robot import RobotFault
from rrl.slot_random import seed_env
from rrl.transforms import Intervention

from ...requests import Requests, stand_still
from ...resumable_env import ResumableEnv
from ...settings import TrainerSettings
from ...storage.transition_log import FOLDER, TransitionLog
from ..collection_metrics import Authority
from ..interface import Annealing
from ..policy_vector import assign
from .ending import Ending
from .hand_over import HandOver, Weights
from .policy_thread import PolicyThread
from .records import Timing, make_record

log = logging.getLogger(__name__)

LATE = {
    "controller": "the controller acts alone in such a step",
    "hold": "such a step holds the last command, as near as the residual's authority allows",
    "stop": "the robot is stopped, and a new episode begins",
}


class _Stopped(Exception):
    """The episode was cut short on purpose."""


IN_VAIN, IN_VAIN_SECONDS = 20, 5.0
"""Resets for a policy that is too late for a single step, and how long it must have been so.

Robots are not reset for ever; one that resets in no time outlives a busy second of its computer.
"""


class Acting:
    """Acts and stores every transition until there are enough, or it is told to stop.

    A step begins at its deadline with the newest observation. The policy has a share of the period
    to answer; what happens to a step without an answer is a setting. A fault of the robot stops it
    and cuts the episode short; resets are tried until it is back.

    Args:
        settings: Of the run.
        env: What is driven.
        policy: From its inputs to ``action``.
        exploration: Adds noise; None: the policy explores by itself.
        pace: Of the environment, or one to keep for it.
        hand_over: Takes transitions and gives weights.
        ending: Looked at in every step; a reset is left at once.
    """

    def __init__(
        self,
        settings: TrainerSettings,
        env: ResumableEnv,
        policy: TensorDictModuleBase,
        exploration: TensorDictModuleBase | None,
        pace: Pace,
        hand_over: HandOver,
        ending: Ending,
    ) -> None:
        self.settings, self.env, self.policy = settings, env, policy
        self.exploration, self.pace, self.hand_over = exploration, pace, hand_over
        self.ending = ending
        modules = [policy] if exploration is None else [policy, exploration]
        self.thread = PolicyThread(TensorDictSequential(*modules), settings.flush_denormals)
        self.log = TransitionLog(hand_over.folder / FOLDER)
        self.authority = Authority.of(env)
        self.requests = Requests()
        env.listen_to(self.requests)
        self._keeps_pace = pace is not getattr(env.base_env, "pace", None)
        operated = (part for part in env.transform if isinstance(part, Intervention))
        self._operated = next(operated, None)
        self._keys = _stored(env)
        self._unwritten: list[TensorDictBase] = []
        self._count, self._annealing = self.log.count, Annealing(exploration)
        self._annealing.reach(self._count)  # who follows another one explores as that one would
        self._weights = Weights(-1, -1, torch.empty(0))
        self._last_command: Tensor | None = None
        self._missed = self._faults = 0  # since the last record
        self._missing_since = 0.0
        self._has_been_late = False
        self._moves = False  # the robot, since it was told to stop
        pace.meanwhile = self._while_there_is_time

    @property
    def is_done(self) -> bool:
        """Whether every transition of the run is stored."""
        return self._count >= self.settings.total_steps

    def run(self) -> None:
        """Play episodes."""
        self._take_weights()
        back = True  # whether the robot did what it should the last time
        while not (self.is_done or self.ending.is_asked):
            self._hear()
            stands = self.requests.paused and not self._moves
            if stands or self.hand_over.is_wanted():
                time.sleep(0.01)
                continue
            with self.hand_over.driving():
                try:
                    back = self._try_episode(back)
                finally:  # whoever has the robot next finds every step before
                    self._write()
                    self.log.sync()
            self._take_weights()
            if not back:
                self._sleep(self.settings.realtime.retry)

    def _try_episode(self, was_fine: bool) -> bool:
        """Play an episode; return whether the robot did what it should."""
        began = time.monotonic()
        try:
            self._hear()
            if self.requests.paused:
                raise _Stopped
            self._moves = True
            with self.ending.at_once():
                td = self.env.reset()
            if not was_fine:
                log.warning("the robot is back; going on with a new episode")
            was_fine = True
            self.pace.start()
            self._episode(td, time.monotonic() - began)
        except RobotFault as fault:
            self._faults += 1
            self._stand_still()
            if was_fine:
                log.warning("the robot is stopped: %s; trying to reset it until it is back", fault)
            return False
        except _Stopped:
            self._stand_still()
        self._hear()
        over = self.is_done or self.ending.is_asked
        if over or self.requests.paused or self.hand_over.is_wanted():
            self._stand_still()
        return True

    def _stand_still(self) -> None:
        """Have the robot stand still, once: whoever does not go on with an episode does."""
        if self._moves:
            stand_still(self.env)
        self._moves = False

    def _episode(self, td: TensorDictBase, reset_seconds: float) -> None:
        first, self._last_command = True, None
        while not (self.is_done or self.ending.is_asked):
            self._hear()
            if self.requests.paused:
                raise _Stopped
            explores = self._count >= (self.settings.controller_steps or 0)
            until = self.pace.scheduled + self.settings.realtime.budget * self.pace.period
            answer = self.thread.ask(td, explores, until)
            timing = Timing(first=first, reset_seconds=reset_seconds)
            td = self._late(td) if answer is None else answer
            td.set(ACTION, td[ACTION].float())
            self._last_command = td[BASE_ACTION] + self.authority.span * td[ACTION]
            td = self.env.step(td)
            if self._operated is not None:  # it may have been an operator's
                self._last_command = self._operated.recall("command")
            if self._keeps_pace:
                self.pace.wait()
            self._keep(td, timing)
            if bool(td["next", "done"].any()):
                return
            td, first, reset_seconds = step_mdp(td), False, 0.0
        raise _Stopped

    def _hear(self) -> None:
        """Hear what a person asks for. The loop sees to a pause itself: a robot does not wait."""
        for request in self.hand_over.heard():
            self.requests.take(request)

    def _late(self, td: TensorDictBase) -> TensorDictBase:
        """Return ``td`` with the action of a step that the policy has no answer for in time."""
        rule, span = self.settings.realtime.late, self.authority.span
        if self._missed == 0:
            self._missing_since = time.monotonic()
        self._missed += 1
        if not self._has_been_late:
            log.warning("a policy's answer was late: %s; from now on it is counted", LATE[rule])
        self._has_been_late = True
        if rule == "stop":
            self._refuse_to_go_on_in_vain()
            raise _Stopped
        action = torch.zeros_like(td[BASE_ACTION])
        if rule == "hold" and self._last_command is not None:
            wanted = (self._last_command - td[BASE_ACTION]) / span
            action = torch.where(span > 0, wanted, 0.0).clamp(-1.0, 1.0)
        return td.set(ACTION, action)

    def _refuse_to_go_on_in_vain(self) -> None:
        seconds = time.monotonic() - self._missing_since
        if self._missed < IN_VAIN or seconds < IN_VAIN_SECONDS:
            return
        wanted = 1e3 * self.settings.realtime.budget * self.pace.period
        raise RuntimeError(
            f"trainer.realtime: expected an answer of the policy within {wanted:.0f} ms, got none "
            f"{self._missed} times in a row, and every time the robot was stopped; raise budget or "
            "period, make the network smaller, or choose another rule for late steps"
        )

    def _keep(self, td: TensorDictBase, timing: Timing) -> None:
        timing = timing._replace(
            period_error=self.pace.error,
            inference=self.thread.seconds,
            weights=self._weights.env_steps,
            missed=self._missed,
            faults=self._faults,
            time=time.time(),
        )
        self._missed = self._faults = 0
        self._unwritten.append(make_record(td.select(*self._keys), timing))
        self._count += 1

    def _while_there_is_time(self) -> None:
        self._write()
        every = self.settings.realtime.weights
        if every != "episode" and self._count % int(every) == 0 and self.thread.idle:
            self._take_weights()

    def _write(self) -> None:
        while self._unwritten:
            self.log.append(self._unwritten[0])
            del self._unwritten[0]
        self._annealing.reach(self._count)

    def _take_weights(self) -> None:
        """Act with the newest weights from now on, all of them."""
        weights = self.hand_over.new_weights()
        if weights is None:
            return
        self.thread.wait()  # weights are exchanged between two inferences
        assign(self.policy, weights.vector)
        if weights.seed != self._weights.seed:
            seed_env(self.env, weights.seed)
        self._weights = weights

    def _sleep(self, seconds: float) -> None:
        ends = time.monotonic() + seconds
        while time.monotonic() < ends and not self.ending.is_asked:
            time.sleep(0.02)


def _stored(env: ResumableEnv) -> list[NestedKey]:
    """Return all that the environment writes, and the action."""
    observation = list(env.observation_spec.keys(True, True))
    ends = env.full_reward_spec.keys(True, True), env.full_done_spec.keys(True, True)
    following = [unravel_key(("next", key)) for key in chain(observation, *ends)]
    return [*observation, ACTION, *following]
