"""Every number of the block-insertion task, its two presets, and the check that they make sense."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Mapping
from typing import Any

CONTROLLERS = ("cartesian", "impedance")
BLOCK_KINDS = ("planar", "free", "fixed")
FORCE_OBSERVATIONS = ("wrench", "force_z")
REWARD_POINTS = ("held_block", "end_effector")
NUM_JOINTS = 7


@dataclasses.dataclass(frozen=True)
class InsertionConfig:
    """The block-insertion task of the paper (section IV), in SI units unless a field says otherwise.

    Lengths are half sizes where the name says so. The world's x axis points away from the robot and
    across the gap, y along the gap, z up; the platform's surface is z = 0.
    """

    # What distinguishes the variants.
    controller: str = "cartesian"
    """``cartesian`` position control, or joint-space ``impedance`` control."""
    blocks: str = "planar"
    """Standing blocks: ``planar`` (slide x, slide y, topple about y), ``free``, or ``fixed``."""
    force_observation: str = "wrench"
    """``wrench`` (three forces, three torques) or ``force_z`` alone."""
    reward_point: str = "held_block"
    """The point that has to reach the goal: ``held_block`` or ``end_effector``."""

    # Geometry.
    held_half_size: tuple[float, float, float] = (0.02, 0.03, 0.05)
    standing_half_size: tuple[float, float, float] = (0.02, 0.03, 0.04)
    chamfer: tuple[float, float] = (0.003, 0.0045)
    """Cut of the standing blocks' inner top edge, along x and z."""
    clearance: float = 0.002
    """Play of the inserted block on each side of the gap when the blocks are aligned."""
    goal_xy: tuple[float, float] = (0.6, 0.0)
    base_height: float = 0.0
    """Height of the robot's mounting plane above the platform's surface, m. Where the tool works at the
    height of the shoulder (-0.35), pressing down does not push the compliant arm sideways."""
    start_height: float = 0.14
    """Height of the inserted block above its goal at reset."""
    start_range: tuple[float, float, float] = (0.01, 0.01, 0.01)
    """The start is drawn uniformly within this distance of its nominal position, per axis."""

    # Orientation of the standing blocks at reset: one of the two.
    yaw_range: float = 0.0
    """Each block's yaw is drawn from U[-yaw_range, yaw_range], rad."""
    yaw_choices: tuple[float, ...] = ()
    """Each block's yaw is one of these, *degrees*; takes the place of ``yaw_range``."""

    # Masses and contact.
    standing_mass: float = 0.15
    held_mass: float = 0.3
    platform_friction: float = 0.3
    standing_friction: float = 0.3
    held_friction: float = 1.0
    """Sliding friction of the held block. MuJoCo takes the larger one of a pair; it must exceed the
    platform's, or a block cannot be dragged without tipping it."""

    # Control.
    action_scale: float = 0.02
    """Displacement of the set point for an action of 1, m."""
    cartesian_stiffness: tuple[float, float] = (4000.0, 100.0)
    """Translation [N/m] and rotation [N m/rad]."""
    cartesian_damping: tuple[float, float] = (250.0, 8.0)
    """Translation [N s/m] and rotation [N m s/rad]."""
    force_limit: float = 60.0
    """Largest force of the Cartesian controller along an axis, N."""
    joint_stiffness: tuple[float, ...] = (350.0, 500.0, 500.0, 480.0, 280.0, 110.0, 80.0)
    """Impedance controller, shoulder to wrist, N m/rad: at the tool of the preset ``real`` about 1100,
    600 and 1200 N/m along x, y and z."""
    joint_damping: tuple[float, ...] = (17.5, 25.0, 25.0, 24.0, 14.0, 5.5, 4.0)
    """Impedance controller, shoulder to wrist, N m s/rad. In proportion to the stiffness, so that the
    tool moves straight towards its set point."""
    ik_rotation_gain: float = 0.4
    """Share of the orientation error that the impedance controller's set point corrects in a step."""
    ik_posture_gain: float = 0.2
    """Share of the way to the home posture that it takes in a step, as far as the tool allows."""

    # Time.
    physics_timestep: float = 0.002
    substeps: int = 25
    """Physics steps a control step (50 ms)."""
    episode_length: int = 50
    """Control steps after which an episode is truncated."""

    # Reward weights (equations 4 and 5 of the paper).
    tilt_weight: float = 0.1
    """lambda, on |theta_l| + |theta_r|."""
    displacement_weight: float = 0.0
    """mu, on the distance of the standing blocks from their desired positions."""
    yaw_weight: float = 0.0
    """beta, on |phi_l| + |phi_r|."""

    # Success.
    position_tolerance: float = 0.012
    """Largest distance of the inserted block from its goal, m."""
    tilt_tolerance: float = 0.1
    """Largest inclination of either standing block, rad."""

    velocity_limit: float = 200.0
    """A generalised velocity beyond this (m/s, rad/s) counts as diverged physics."""

    @property
    def goal(self) -> tuple[float, float, float]:
        """Where the centre of the inserted block belongs, m."""
        return (*self.goal_xy, self.held_half_size[2])

    @property
    def block_offset(self) -> float:
        """Distance along x of a standing block's centre from the goal, m."""
        return self.held_half_size[0] + self.clearance + self.standing_half_size[0]

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

    def validate(self) -> InsertionConfig:
        """Returns the config itself.

        Raises:
            ValueError: a value that is out of range, or geometry that cannot be built; the message
                names the field, what it needs and what came.
        """
        _check_choices(self)
        _check_numbers(self)
        _check_geometry(self)
        return self


PRESETS: dict[str, InsertionConfig] = {
    "sim": InsertionConfig(),
    "real": InsertionConfig(
        controller="impedance",
        blocks="free",
        force_observation="force_z",
        reward_point="end_effector",
        yaw_choices=(-20.0, 0.0, 20.0),
        base_height=-0.35,
        chamfer=(0.0055, 0.00825),
        displacement_weight=0.5,
        yaw_weight=0.1,
    ),
}


def make_config(
    variant: str | InsertionConfig, overrides: Mapping[str, Any] | None = None
) -> InsertionConfig:
    """The preset ``variant``, or the config itself, with some fields replaced; lists become tuples.

    Overriding ``yaw_range`` alone puts it in the place of the preset's ``yaw_choices``.

    Raises:
        ValueError: unknown variant or field (with the choices), or values that do not fit together.
    """
    if not isinstance(variant, InsertionConfig) and variant not in PRESETS:
        raise ValueError(f"unknown variant {variant!r}; choose one of {sorted(PRESETS)}")
    values = {name: _to_tuple(value) for name, value in (overrides or {}).items()}
    fields = [field.name for field in dataclasses.fields(InsertionConfig)]
    for name in values:
        if name not in fields:
            near = difflib.get_close_matches(name, fields, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise ValueError(f"unknown task setting {name!r}{hint}; choose from {sorted(fields)}")
    if "yaw_range" in values:
        values.setdefault("yaw_choices", ())
    base = variant if isinstance(variant, InsertionConfig) else PRESETS[variant]
    return dataclasses.replace(base, **values).validate()


def _to_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _check_choices(config: InsertionConfig) -> None:
    for name, choices in (
        ("controller", CONTROLLERS),
        ("blocks", BLOCK_KINDS),
        ("force_observation", FORCE_OBSERVATIONS),
        ("reward_point", REWARD_POINTS),
    ):
        value = getattr(config, name)
        if value not in choices:
            raise ValueError(f"{name} must be one of {list(choices)}, got {value!r}")


_POSITIVE = (
    "held_half_size",
    "standing_half_size",
    "standing_mass",
    "held_mass",
    "action_scale",
    "cartesian_stiffness",
    "force_limit",
    "joint_stiffness",
    "physics_timestep",
    "start_height",
    "position_tolerance",
    "tilt_tolerance",
    "velocity_limit",
)
_NOT_NEGATIVE = (
    "chamfer",
    "clearance",
    "start_range",
    "yaw_range",
    "platform_friction",
    "standing_friction",
    "held_friction",
    "cartesian_damping",
    "joint_damping",
    "ik_rotation_gain",
    "ik_posture_gain",
    "tilt_weight",
    "displacement_weight",
    "yaw_weight",
)
_ANY_SIGN = ("goal_xy", "base_height", "yaw_choices")
_LENGTHS = {
    "held_half_size": 3,
    "standing_half_size": 3,
    "chamfer": 2,
    "goal_xy": 2,
    "start_range": 3,
    "cartesian_stiffness": 2,
    "cartesian_damping": 2,
    "joint_stiffness": NUM_JOINTS,
    "joint_damping": NUM_JOINTS,
}


def _check_numbers(config: InsertionConfig) -> None:
    for name in (*_POSITIVE, *_NOT_NEGATIVE, *_ANY_SIGN):
        value = getattr(config, name)
        parts = value if isinstance(value, tuple) else (value,)
        if name in _LENGTHS and (not isinstance(value, tuple) or len(parts) != _LENGTHS[name]):
            raise ValueError(f"{name} needs {_LENGTHS[name]} numbers, got {value!r}")
        if not all(isinstance(x, (int, float)) and math.isfinite(x) for x in parts):
            raise ValueError(f"{name} must be finite, got {value!r}")
        if name in _POSITIVE and not all(x > 0 for x in parts):
            raise ValueError(f"{name} must be positive, got {value!r}")
        if name in _NOT_NEGATIVE and not all(x >= 0 for x in parts):
            raise ValueError(f"{name} must not be negative, got {value!r}")
    for name in ("substeps", "episode_length"):
        value = getattr(config, name)
        if not isinstance(value, int) or value < 1:
            raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")


def _check_geometry(config: InsertionConfig) -> None:
    if config.yaw_choices and config.yaw_range:
        raise ValueError(
            f"yaw_range={config.yaw_range} and yaw_choices={config.yaw_choices} exclude each "
            "other: give yaw_range for a uniform draw or yaw_choices for a discrete one"
        )
    size_x, size_y, size_z = config.standing_half_size
    if config.chamfer[0] >= 2 * size_x or config.chamfer[1] >= 2 * size_z:
        raise ValueError(
            f"chamfer {config.chamfer} cuts away a whole side of a standing block of half size "
            f"{config.standing_half_size}; it must be smaller than {(2 * size_x, 2 * size_z)}"
        )
    if (config.chamfer[0] > 0) != (config.chamfer[1] > 0):
        raise ValueError(f"chamfer {config.chamfer}: give both cuts, or (0, 0) for a square edge")
    if not config.max_yaw < math.pi / 2:
        raise ValueError(f"the largest yaw must be below pi/2, got {config.max_yaw:.3f} rad")
    reach = size_x * math.cos(config.max_yaw) + size_y * math.sin(config.max_yaw)
    if reach > config.block_offset:
        raise ValueError(
            f"standing blocks turned by {config.max_yaw:.3f} rad reach {reach:.4f} m across a gap "
            f"whose middle is {config.block_offset:.4f} m away: they would overlap; make the yaw "
            "or the standing blocks smaller, or the clearance larger"
        )
    lowest = config.held_half_size[2] * 2 + config.start_height - config.start_range[2]
    if lowest - 2 * config.held_half_size[2] <= 2 * size_z:
        raise ValueError(
            f"start_height {config.start_height} (less start_range {config.start_range[2]}) puts "
            f"the held block into the standing blocks of height {2 * size_z}; raise it"
        )
    x, y = config.goal_xy
    distance = math.hypot(x, y, config.goal[2] + config.start_height - config.base_height)
    if math.hypot(x, y) < 0.4 or distance > 0.85:
        raise ValueError(
            f"goal_xy {config.goal_xy} is out of the arm's reach: the goal must be 0.4 m or more "
            f"from the robot's axis and the start within 0.85 m of its base, got {distance:.2f} m"
        )
