"""Gymnasium-Robotics' Fetch tasks with hand controllers, as Residual Policy Learning has them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import packages

Vector = NDArray[np.floating]
GAIN = 10.0
"""Commands per metre: the arm is told to go where it shall be in one step."""


def make(task: str) -> Any:
    """Make a task with its dense reward: minus the distance of object and goal [m].

    Args:
        task: Registered name, such as ``FetchPush-v4``.
    """
    packages.gymnasium_robotics()
    return packages.gymnasium().make(task, reward_type="dense")


class Push:
    """Goes behind the object and pushes it straight towards the goal.

    Args:
        object_offset: By how much it misjudges where the object is (x, y, z) [m].
    """

    def __init__(self, object_offset: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self.object_offset = np.array(object_offset)
        self.reset()

    def reset(self) -> None:
        """Forget that the object is being pushed."""
        self.pushes = False

    def __call__(self, observation: Vector, goal: Vector) -> Vector:
        """Return the hand's motion and the closed gripper ``[4]``."""
        hand, thing = observation[:3], observation[3:6] + self.object_offset
        way = (goal - thing) * [1.0, 1.0, 0.0]
        distance = float(np.linalg.norm(way))
        if distance < 0.03:
            return _command(np.zeros(3), -1.0)
        direction = way / distance
        behind = thing - 0.07 * direction
        off = float(np.linalg.norm((hand - behind)[:2]))
        if self.pushes and direction[:2] @ (thing - hand)[:2] < 0:
            self.pushes = False
        if off > 0.02 and not self.pushes:
            height = 0.08 if off > 0.04 else 0.0  # over the object, not through it
            return _command(_above(behind, height) - hand, -1.0)
        self.pushes = True
        return _command(thing + 0.02 * direction - hand, -1.0)


class PickAndPlace:
    """Goes above the object, down, closes the gripper and carries the object to the goal.

    Args:
        object_offset: By how much it misjudges where the object is (x, y, z) [m].
    """

    GRASP_STEPS = 4

    def __init__(self, object_offset: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self.object_offset = np.array(object_offset)
        self.reset()

    def reset(self) -> None:
        """Forget that the object is held."""
        self.steps_closed = 0

    def __call__(self, observation: Vector, goal: Vector) -> Vector:
        """Return the hand's motion and the gripper's ``[4]``."""
        hand, thing = observation[:3], observation[3:6] + self.object_offset
        to_thing = thing - hand
        distance = float(np.linalg.norm(to_thing))
        if self.steps_closed == 0:
            aside = float(np.linalg.norm(to_thing[:2]))
            if aside > 0.015:
                above = 0.08 if aside > 0.03 else 0.02
                return _command(_above(to_thing, above), 1.0)
            if distance > 0.02:
                return _command(to_thing, 1.0)
        self.steps_closed += 1
        if self.steps_closed <= self.GRASP_STEPS:
            return _command(to_thing, -1.0)
        if distance > 0.05:  # it was lost
            self.steps_closed = 0
        return _command(goal - hand, -1.0)


def _above(point: Vector, height: float) -> Vector:
    return point + np.array([0.0, 0.0, height])


def _command(way: Vector, gripper: float) -> Vector:
    return np.append(np.clip(GAIN * way, -1.0, 1.0), gripper)
