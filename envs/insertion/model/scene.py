"""Robot, blocks and platform together in one MJCF model."""

from __future__ import annotations

import copy
from typing import Any

import mujoco
from dm_control import mjcf

from ..config import InsertionConfig
from .actuators import add_cartesian_actuators, add_joint_actuators
from .appearance import mark
from .arena import PlatformArena
from .blocks import HeldBlock, StandingBlock
from .gripper import ParallelGripper
from .sawyer import Sawyer
from .sensors import add_sensors

COLORS = ((0.13, 0.37, 0.70, 1.0), (0.10, 0.52, 0.50, 1.0))
"""Of the left and right standing block."""
HELD_COLOR = (0.95, 0.66, 0.13, 1.0)


def build_scene(config: InsertionConfig) -> PlatformArena:
    """Return the arena with the task's entities, actuators and sensors."""
    arena = PlatformArena(config)
    arm = Sawyer()
    arena.attach(arm).pos = (0.0, 0.0, config.base_height)
    gripper = ParallelGripper(opening=2 * config.held_half_size[0])
    arm.attach(gripper, arm.hand_site)
    held = HeldBlock(config.held_half_size, config.held_mass, config.held_friction, HELD_COLOR)
    gripper.attach(held, gripper.grip_site)
    frames = _stand_blocks(arena, config)
    if config.controller == "cartesian":
        add_cartesian_actuators(arena.mjcf_model, config, held.center_site)
    else:
        add_joint_actuators(arena.mjcf_model, config, arm.joints)
    gap = mark(arena.mjcf_model.worldbody, "gap", pos=config.goal)
    add_sensors(arena.mjcf_model, arm, held, frames, gap)
    return arena


def compile_model(config: InsertionConfig) -> mujoco.MjModel:
    """Return the task's compiled model, the same that the composer environment gets."""
    physics = mjcf.Physics.from_mjcf_model(build_scene(config).mjcf_model)
    model = copy.copy(physics.model.ptr)
    physics.free()
    return model


def _stand_blocks(arena: PlatformArena, config: InsertionConfig) -> list[Any]:
    frames = []
    for name, inner_side, color, position in zip(
        ("left_block", "right_block"), (1, -1), COLORS, config.block_goals, strict=True
    ):
        block = StandingBlock(
            name, config.standing_half_size, config.chamfer, inner_side,
            config.standing_mass, config.standing_friction, color,
        )  # fmt: skip
        frame = arena.attach(block)
        frame.pos = position
        _add_joints(frame, config.blocks)
        frames.append(frame)
    return frames


def _add_joints(frame: Any, kind: str) -> None:
    """Add the degrees of freedom of a standing block.

    A rigid block cannot topple with its center at a fixed height, so the planar block of the paper
    (slide x, slide y, topple about y) also slides along z, where the platform holds it up.
    """
    if kind == "free":
        frame.add("freejoint")
    elif kind == "planar":
        for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("z", (0, 0, 1))):
            frame.add("joint", name=name, type="slide", axis=axis)
        frame.add("joint", name="topple", type="hinge", axis=(0, 1, 0))
