"""The Sawyer arm as a composer entity, with the manufacturer's kinematics and inertias."""

from __future__ import annotations

from typing import Any, NamedTuple

from dm_control import composer, mjcf

from .appearance import add_materials, dress_arm, mark

Vector = tuple[float, ...]


class Link(NamedTuple):
    """One link and the hinge, about its own z axis, that carries it. SI units, quaternions wxyz."""

    position: Vector
    quaternion: Vector
    range: Vector
    max_torque: float
    mass: float
    center_of_mass: Vector
    inertia_quaternion: Vector
    inertia: Vector


# Source: the manufacturer's public `sawyer_description`.
LINKS = (
    Link(
        (0, 0, 0.08), (1, 0, 0, 0), (-3.0503, 3.0503), 80.0,
        5.3213, (0.024366, 0.010969, 0.14363),
        (0.894823, 0.00899958, -0.170275, 0.412573), (0.0651588, 0.0510944, 0.0186218),
    ),
    Link(
        (0.081, 0.05, 0.237), (0.5, -0.5, 0.5, 0.5), (-3.8095, 2.2736), 80.0,
        4.505, (-0.0030849, -0.026811, 0.092521),
        (0.424888, 0.891987, 0.132364, -0.0794296), (0.0224339, 0.0221624, 0.0097097),
    ),
    Link(
        (0, -0.14, 0.1425), (0.707107, 0.707107, 0, 0), (-3.0426, 3.0426), 40.0,
        1.745, (-0.00016044, -0.014967, 0.13582),
        (0.707831, -0.0524761, 0.0516007, 0.702537), (0.0257928, 0.025506, 0.00292515),
    ),
    Link(
        (0, -0.042, 0.26), (0.707107, -0.707107, 0, 0), (-3.0439, 3.0439), 40.0,
        2.5097, (-0.0048135, -0.0281, -0.084154),
        (0.902999, 0.385391, -0.0880901, 0.168247), (0.0102404, 0.0096997, 0.00369622),
    ),
    Link(
        (0, -0.125, -0.1265), (0.707107, 0.707107, 0, 0), (-2.9761, 2.9761), 9.0,
        1.1136, (-0.0018844, 0.0069001, 0.1341),
        (0.803612, 0.031257, -0.0298334, 0.593582), (0.0136549, 0.0135493, 0.00127353),
    ),
    Link(
        (0, 0.031, 0.275), (0.707107, -0.707107, 0, 0), (-2.9761, 2.9761), 9.0,
        1.5625, (0.0061133, -0.023697, 0.076416),
        (0.404076, 0.9135, 0.0473125, 0.00158335), (0.00474131, 0.00422857, 0.00190672),
    ),
    Link(
        (0, -0.11, 0.1053), (0.0616248, 0.06163, -0.704416, 0.704416), (-4.7124, 4.7124), 9.0,
        0.3292, (-8.0726e-06, 0.0085838, -0.0049566),
        (0.479044, 0.515636, -0.513069, 0.491322), (0.000360258, 0.000311068, 0.000214974),
    ),
)  # fmt: skip
HAND_POSITION = (0.0, 0.0, 0.0245)
HAND_QUATERNION = (0.707107, 0.0, 0.0, 0.707107)
BASE_MASS = 2.0687

# The tool points straight down and its x axis along the world's -x.
TOOL_DOWN = (0.0, -1.18, 0.0, 2.18, 0.0, 0.57, 3.3161 - 1.5707963)

JOINT_DAMPING = (2.0, 2.0, 1.0, 1.0, 0.5, 0.5, 0.5)
"""Passive, N m s/rad."""
JOINT_ARMATURE = (0.1, 0.1, 0.1, 0.1, 0.05, 0.05, 0.05)
"""Reflected rotor inertia, kg m^2."""


class Sawyer(composer.ModelWrapperEntity):
    """Seven joints, no actuators (the task adds its controller's) and no collision geometry.

    The arm compensates gravity; the compensation counts against the joints' torque limits.

    Attributes:
        joints: The seven hinges, shoulder to wrist.
        links: The bodies that the joints carry; a body's origin is its joint's anchor.
        wrist_site: Site of the force-torque sensor, between the last link and the gripper.
        hand_site: Where a gripper is attached.
    """

    def _build(self, name: str = "sawyer") -> None:
        root = mjcf.RootElement(model=name)
        super()._build(root)
        root.compiler.angle = "radian"
        add_materials(root)
        base = root.worldbody.add("body", name="base")
        base.add("inertial", pos=(0, 0, 0), mass=BASE_MASS, diaginertia=(0.02, 0.02, 0.02))
        self.joints: list[Any] = []
        self.links: list[Any] = []
        body = base
        for index, link in enumerate(LINKS):
            body = body.add(
                "body", name=f"right_l{index}", pos=link.position, quat=link.quaternion, gravcomp=1
            )
            body.add(
                "inertial", pos=link.center_of_mass, mass=link.mass,
                quat=link.inertia_quaternion, diaginertia=link.inertia,
            )  # fmt: skip
            joint = body.add(
                "joint", name=f"right_j{index}", type="hinge", axis=(0, 0, 1),
                range=link.range, limited=True,
                damping=JOINT_DAMPING[index], armature=JOINT_ARMATURE[index],
                actuatorfrcrange=(-link.max_torque, link.max_torque), actuatorgravcomp=True,
            )  # fmt: skip
            self.joints.append(joint)
            self.links.append(body)
        hand = body.add("body", name="hand", pos=HAND_POSITION, quat=HAND_QUATERNION, gravcomp=1)
        hand.add("inertial", pos=(0, 0, 0), mass=1e-6, diaginertia=(1e-8, 1e-8, 1e-8))
        # Turned by pi about y, so that it is aligned with the world in the posture TOOL_DOWN.
        self.wrist_site = mark(hand, "wrist", quat=(0, 0, 1, 0))
        self.hand_site = mark(hand, "mount")
        dress_arm(base, self.links)
