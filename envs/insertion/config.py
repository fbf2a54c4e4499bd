"""Every number of the block-insertion task, its two presets, and the check that they fit."""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationError, model_validator
from pydantic.dataclasses import dataclass
from typing_extensions import Self

NUM_JOINTS = 7
Number = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0)]
NonNegative = Annotated[float, Field(strict=True, ge=0)]
Offset = Annotated[float, Field(strict=True, ge=0, le=0.05)]
Count = Annotated[int, Field(strict=True, ge=1)]
PerJoint = Field(min_length=NUM_JOINTS, max_length=NUM_JOINTS)


@dataclass(frozen=True, config=ConfigDict(allow_inf_nan=False))
class InsertionConfig:
    """The block-insertion task of the paper (section IV), in SI units unless stated otherwise.

    The world's x axis points away from the robot and across the gap, y along the gap, z up; the
    platform's surface is z = 0.

    Raises:
        ValueError: If a value is out of range, or the geometry cannot be built.
    """

    # What distinguishes the variants.
    controller: Literal["cartesian", "impedance"] = "cartesian"
    """Position control of the tool, or joint-space impedance control."""
    blocks: Literal["planar", "free", "fixed"] = "planar"
    """Standing blocks: ``planar`` (slide x, slide y, topple about y), ``free``, or ``fixed``."""
    force_observation: Literal["wrench", "force_z"] = "wrench"
    """Three forces and three torques, or the force along z alone."""
    reward_point: Literal["held_block", "end_effector"] = "held_block"
    """The point that has to reach the goal."""

    # Geometry.
    held_half_size: tuple[Positive, Positive, Positive] = (0.02, 0.03, 0.05)
    standing_half_size: tuple[Positive, Positive, Positive] = (0.02, 0.03, 0.04)
    chamfer: tuple[NonNegative, NonNegative] = (0.003, 0.0045)
    """Cut of the standing blocks' inner top edge, along x and z."""
    clearance: NonNegative = 0.002
    """Play of the inserted block on each side of the gap when the blocks are aligned."""
    goal_xy: tuple[Number, Number] = (0.6, 0.0)
    base_height: Number = 0.0
    """Height of the robot's mounting plane above the platform. Where the tool works at the height
    of the shoulder (-0.35), pressing down does not push the compliant arm sideways."""
    start_height: Positive = 0.14
    """Height of the inserted block above its goal at reset."""
    start_range: tuple[NonNegative, NonNegative, NonNegative] = (0.01, 0.01, 0.01)
    """The start is drawn uniformly within this distance of its nominal position, per axis."""

    place_range: tuple[Offset, Offset] = (0.0, 0.0)
    """The standing blocks, and the gap with the goal between them, stand within this distance of
    where the robot believes them (``goal_xy``), drawn uniformly at reset, x and y, m."""

    # Orientation of the standing blocks at reset: one of the two.
    yaw_range: NonNegative = 0.0
    """Each block's yaw is drawn from U[-yaw_range, yaw_range], rad."""
    yaw_choices: tuple[Number, ...] = ()
    """Each block's yaw is one of these, *degrees*; replaces ``yaw_range``."""

    # Masses and contact.
    standing_mass: Positive = 0.15
    held_mass: Positive = 0.3
    platform_friction: NonNegative = 0.3
    standing_friction: NonNegative = 0.3
    held_friction: NonNegative = 1.0
    """Sliding friction of the held block. MuJoCo takes the larger one of a pair; it must exceed the
    platform's, or a block cannot be dragged without tipping it."""

    # Control.
    action_scale: Positive = 0.02
    """Displacement of the set point for an action of 1, m."""
    cartesian_stiffness: tuple[Positive, Positive] = (4000.0, 100.0)
    """Translation [N/m] and rotation [N m/rad]."""
    cartesian_damping: tuple[NonNegative, NonNegative] = (250.0, 8.0)
    """Translation [N s/m] and rotation [N m s/rad]."""
    force_limit: Positive = 60.0
    """Largest force of the Cartesian controller along an axis, N."""
    joint_stiffness: Annotated[tuple[Positive, ...], PerJoint] = (
        350.0, 500.0, 500.0, 480.0, 280.0, 110.0, 80.0,
    )  # fmt: skip
    """Impedance controller, shoulder to wrist, N m/rad: at the tool of the preset ``real`` about
    1100, 600 and 1200 N/m along x, y and z."""
    joint_damping: Annotated[tuple[NonNegative, ...], PerJoint] = (
        17.5, 25.0, 25.0, 24.0, 14.0, 5.5, 4.0,
    )  # fmt: skip
    """Impedance controller, N m s/rad. In proportion to the stiffness, so that the tool moves
    straight towards its set point."""
    ik_rotation_gain: NonNegative = 0.4
    """Share of the orientation error that the impedance controller corrects in a step."""
    ik_posture_gain: NonNegative = 0.2
    """Share of the way to the home posture that it takes in a step, as far as the tool allows."""

    # Time.
    physics_timestep: Positive = 0.002
    substeps: Count = 25
    """Physics steps in a control step (50 ms)."""
    episode_length: Count = 50
    """Control steps after which an episode is truncated."""

    # Reward and success.
    reward_weights: dict[str, NonNegative] = dataclasses.field(default_factory=dict)
    """Weights by the term's name; the others keep those of ``quantities.REWARD_TERMS``."""
    position_tolerance: Positive = 0.012
    """Largest distance of the inserted block from its goal, m."""
    tilt_tolerance: Positive = 0.1
    """Largest inclination of either standing block, rad."""

    velocity_limit: Positive = 200.0
    """A generalized velocity beyond this (m/s, rad/s) counts as diverged physics."""

    @property
    def goal(self) -> tuple[float, float, float]:
        """Where the robot believes that the center of the inserted block belongs, m."""
        return (*self.goal_xy, self.held_half_size[2])

    @property
    def block_offset(self) -> float:
        """Distance along x of a standing block's center from the goal, m."""
        return self.held_half_size[0] + self.clearance + self.standing_half_size[0]

    @property
    def block_goals(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """X_g of blocks that stand where the robot believes: centers, left and right, m."""
        (x, y), height = self.goal_xy, self.standing_half_size[2]
        return (x - self.block_offset, y, height), (x + self.block_offset, y, height)

    @property
    def max_yaw(self) -> float:
        """Largest yaw that a reset can draw, rad."""
        if self.yaw_choices:
            return math.radians(max(abs(choice) for choice in self.yaw_choices))
        return self.yaw_range

    @property
    def control_timestep(self) -> float:
        """Duration of one control step, s."""
        return self.physics_timestep * self.substeps

    @model_validator(mode="after")
    def _check_geometry(self) -> Self:
        yaw, (size_x, size_y, size_z) = self.max_yaw, self.standing_half_size
        if self.yaw_choices and self.yaw_range:
            raise ValueError(
                f"yaw_range: expected 0 beside yaw_choices {self.yaw_choices}, got {self.yaw_range}"
            )
        if self.chamfer[0] >= 2 * size_x or self.chamfer[1] >= 2 * size_z:
            sides = 2 * size_x, 2 * size_z
            raise ValueError(f"chamfer: expected less than the sides {sides}, got {self.chamfer}")
        if (self.chamfer[0] > 0) != (self.chamfer[1] > 0):
            raise ValueError(f"chamfer: expected two cuts, or (0, 0) for none, got {self.chamfer}")
        if yaw >= math.pi / 2:
            raise ValueError(f"yaw_range or yaw_choices: expected below pi/2, got {yaw:.3f} rad")
        reach = size_x * math.cos(yaw) + size_y * math.sin(yaw)
        if reach > self.block_offset:
            raise ValueError(
                "yaw_range or yaw_choices: expected standing blocks that do not overlap, got "
                f"{yaw:.3f} rad; reduce it or the blocks, or increase the clearance"
            )
        if self.start_height - self.start_range[2] <= 2 * size_z:
            raise ValueError(
                f"start_height: expected more than the blocks' height {2 * size_z:g} plus "
                f"start_range {self.start_range[2]}, got {self.start_height}"
            )
        x, y = self.goal_xy
        distance = math.hypot(x, y, self.goal[2] + self.start_height - self.base_height)
        if math.hypot(x, y) < 0.4 or distance > 0.85:
            raise ValueError(
                "goal_xy: expected within reach (0.4 m or more from the arm's axis, start at most "
                f"0.85 m from its base), got {self.goal_xy} and {distance:.2f} m"
            )
        return self


PRESETS = {
    "sim": InsertionConfig(),
    "real": InsertionConfig(
        controller="impedance",
        blocks="free",
        force_observation="force_z",
        reward_point="end_effector",
        yaw_choices=(-20.0, 0.0, 20.0),
        base_height=-0.35,
        chamfer=(0.0055, 0.00825),
        reward_weights={"displacement": 0.1, "yaw": 0.05},
    ),
}
"""The task's variants by name."""


def make_config(
    variant: str | InsertionConfig, overrides: Mapping[str, Any] | None = None
) -> InsertionConfig:
    """Return the preset ``variant``, or the config itself, with some fields replaced.

    Overriding ``yaw_range`` alone removes the preset's ``yaw_choices``; ``reward_weights`` that are
    not named stay as they are.

    Raises:
        ValueError: If a variant or field is unknown, or values are out of range or do not fit.
    """
    if not isinstance(variant, InsertionConfig) and variant not in PRESETS:
        raise ValueError(f"variant: expected one of {sorted(PRESETS)}, got {variant!r}")
    base = variant if isinstance(variant, InsertionConfig) else PRESETS[variant]
    values = dict(overrides or {})
    fields = sorted(field.name for field in dataclasses.fields(InsertionConfig))
    for name in sorted(set(values).difference(fields)):
        near = difflib.get_close_matches(name, fields, n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise ValueError(f"task settings: expected names of {fields}, got {name!r}{hint}")
    if "yaw_range" in values:
        values.setdefault("yaw_choices", ())
    if isinstance(values.get("reward_weights"), Mapping):
        values["reward_weights"] = {**base.reward_weights, **values["reward_weights"]}
    try:
        return dataclasses.replace(base, **values)
    except ValidationError as error:
        raise ValueError(explain(error)) from None


def explain(error: ValidationError) -> str:
    """Return what pydantic found, each as ``name: expected X, got Y``."""
    return "; ".join(map(_explain_one, error.errors()))


def _explain_one(error: Mapping[str, Any]) -> str:
    if error["type"] == "value_error":
        return str(error["ctx"]["error"])
    message = "expected a value" if error["type"] == "missing" else error["msg"]
    message = re.sub(r"^(Input|Tuple) should (be|have) ", "expected ", message)
    return f"{'.'.join(map(str, error['loc']))}: {message}, got {error['input']!r}"
