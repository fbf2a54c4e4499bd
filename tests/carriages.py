"""A robot of a test's own, and its environment."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from rrl.controllers import ProportionalController
from rrl.envs import RobotEnv
from rrl.robot import Description, EntrySpec, Observation, Robot
from rrl.trainers.environment import EnvironmentFactory, Input

PERIOD, EPISODE_STEPS = 0.005, 10


class Carriage(Robot):
    """Goes on with its last command, and writes down what it is told; its place counts commands.

    Args:
        at_command, at_reset: What happens in which command or reset, the first being 1.
    """

    description = Description(
        entries={"end_effector_position": EntrySpec((2,)), "goal": EntrySpec((2,))}
        | {"reward": EntrySpec((1,))},
        low=(-1.0, -1.0),
        high=(1.0, 1.0),
        period=PERIOD,
    )

    def __init__(
        self,
        at_command: Mapping[int, Callable[[], object]] | None = None,
        at_reset: Mapping[int, Callable[[], object]] | None = None,
    ) -> None:
        self.told: list[str] = []
        self._clock, self._moves = 0.0, 0
        self._due = {"command": dict(at_command or {}), "reset": dict(at_reset or {})}

    def observe(self):
        self._clock += PERIOD
        place = np.full(2, self._moves)
        entries = {"end_effector_position": place, "goal": np.ones(2), "reward": [0.0]}
        return Observation(entries, self._clock)

    def command(self, action):
        self._moves += 1
        self._hear("command")

    def reset(self, seed=None):
        self._moves = 0
        self._hear("reset")

    def stop(self):
        self.told.append("stop")
        self.at_stop()

    def at_stop(self):
        """Nothing else."""

    def close(self):
        self.told.append("close")

    def _hear(self, what):
        self.told.append(what)
        if act := self._due[what].pop(self.told.count(what), None):
            act()


def carriage_factory(robot: Robot | Callable[[], Robot], **changes: object) -> EnvironmentFactory:
    """The environment of a robot, or of what makes one, under a proportional controller."""
    return EnvironmentFactory(
        base=lambda: RobotEnv(robot, episode_steps=EPISODE_STEPS),
        controller=partial(ProportionalController, gain=10.0, clip=0.5),
        inputs={"end_effector_position": Input(), "goal": Input()},
        batching="serial",
        max_episode_steps=EPISODE_STEPS,
        **changes,
    )
