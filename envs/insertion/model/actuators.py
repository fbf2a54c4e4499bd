"""The low-level controllers, as MuJoCo actuators that act at every physics step."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..config import InsertionConfig
from .appearance import mark
from .sawyer import LINKS

ROTATION_LIMIT = 20.0
"""Of the Cartesian controller about an axis, N m."""


def add_cartesian_actuators(root: Any, config: InsertionConfig, tool_site: Any) -> None:
    """Add a Cartesian position controller.

    Six affine actuators between the tool's site and a reference site: translation against one that
    is aligned with the world, rotation against one that points down, because the rotation error is
    an exponential map and would be singular near pi. The control is the set point relative to the
    goal [m], then the orientation relative to "down" [rad].
    """
    references = [
        mark(root.worldbody, name, pos=config.goal, quat=quat)
        for name, quat in (("goal", (1, 0, 0, 0)), ("goal_down", (0, 1, 0, 0)))
    ]
    limits = (config.force_limit, ROTATION_LIMIT)
    for index, axis in enumerate(("x", "y", "z", "rx", "ry", "rz")):
        kind = index // 3  # translation, rotation
        _add_servo(
            root, axis, config.cartesian_stiffness[kind], config.cartesian_damping[kind],
            limits[kind], site=tool_site, refsite=references[kind], gear=np.eye(6)[index],
        )  # fmt: skip


def add_joint_actuators(root: Any, config: InsertionConfig, joints: list[Any]) -> None:
    """Add a compliant position servo on each joint, within the published torque limits."""
    gains = zip(config.joint_stiffness, config.joint_damping, strict=True)
    for joint, link, (stiffness, damping) in zip(joints, LINKS, gains, strict=True):
        _add_servo(root, joint.name, stiffness, damping, link.max_torque, joint=joint)


def _add_servo(
    root: Any, name: str, stiffness: float, damping: float, limit: float, **target: Any
) -> None:
    root.actuator.add(
        "general",
        name=name,
        gainprm=(stiffness,),
        biastype="affine",
        biasprm=(0, -stiffness, -damping),
        forcelimited=True,
        forcerange=(-limit, limit),
        **target,
    )
