"""robosuite's Lift (Zhu et al., 2020): a Panda under operational-space control lifts a cube."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import packages

Vector = NDArray[np.floating]
OBSERVED = ["robot0_eef_pos", "robot0_eef_quat", "robot0_gripper_qpos", "cube_pos", "cube_quat"]

ABOVE = np.array([0.0, 0.0, 0.05])
"""Where the gripper waits, from the cube [m]."""


def make_lift() -> Any:
    """Make the task with its shaped reward, one step every 50 ms, without an end of its own."""
    robosuite = packages.robosuite()
    env = robosuite.make(
        "Lift",
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        reward_shaping=True,
        hard_reset=False,
        ignore_done=True,
    )
    return robosuite.wrappers.GymWrapper(env, keys=OBSERVED, flatten_obs=False)


def seed(env: Any, number: int) -> None:
    """Seed a task, which draws from NumPy's global generator (1.5.1) or from its own (1.5.2)."""
    np.random.seed(number)  # noqa: NPY002 - the one that robosuite draws from
    env.env.rng = env.env.placement_initializer.rng = np.random.default_rng(number)


def solved(env: Any) -> bool:
    """Return whether the task says that it is solved, which its ``info`` does not."""
    return bool(env.env._check_success())


class Lift:
    """Goes above the cube, down, closes the gripper and lifts.

    Args:
        object_offset: By how much it misjudges where the cube is (x, y, z) [m].
    """

    CLOSING_STEPS = 8

    def __init__(self, object_offset: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self.object_offset = np.array(object_offset)
        self.reset()

    def reset(self) -> None:
        """Forget that the cube is held."""
        self.steps_closed = 0

    def __call__(self, hand: Vector, cube: Vector) -> Vector:
        """Return motion, rotation and gripper ``[7]``, in the operational-space controller's units.

        Args:
            hand: Position of the gripper ``[3]`` [m].
            cube: Position of the cube ``[3]`` [m].
        """
        way = cube + self.object_offset - hand
        aside = float(np.linalg.norm(way[:2]))
        if self.steps_closed == 0 and aside > 0.015:
            return _command(way + ABOVE, -1.0)
        if self.steps_closed == 0 and abs(way[2]) > 0.01:
            return _command(way, -1.0)
        self.steps_closed += 1
        if self.steps_closed < self.CLOSING_STEPS:
            return _command(np.zeros(3), 1.0)
        return _command(np.array([0.0, 0.0, 0.1]), 1.0)


def _command(way: Vector, gripper: float) -> Vector:
    """Return a command for a way [m]; a unit is 5 cm, of which a step covers a part."""
    return np.concatenate([np.clip(way / 0.05, -1.0, 1.0), np.zeros(3), [gripper]])
