"""dm_control: the suite's cart-pole, and the Jaco arm that reaches for a site."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray
from torchrl.envs import DMControlEnv

from ..composer import ComposerEnv
from ..pictures import mujoco_state

Vector = NDArray[np.floating]
REACH = "reach_site_features"
DAMPING = 0.1
"""Of the least-squares inverse, in units of the Jacobian [m/rad]."""


class Suite(DMControlEnv):
    """A task of dm_control's suite that can be filmed."""

    def physics_state(self) -> Vector:
        """Return the physics state, for :func:`rrl.envs.render_mujoco`."""
        return mujoco_state(self)


class CartPole:
    """Feedback of the pole's state alone: it balances the pole and lets the cart drift away.

    Args:
        stiffness: Command for the pole's inclination [1/rad].
        damping: Command for its angular velocity [s/rad].
    """

    def __init__(self, stiffness: float = 1.0, damping: float = 0.1) -> None:
        self.stiffness, self.damping = stiffness, damping

    def __call__(self, position: Vector, velocity: Vector) -> Vector:
        """Return the cart's command ``[1]``, from (x, cos, sin) and (x', angle')."""
        angle = np.arctan2(position[2], position[1])
        return np.clip([self.stiffness * angle + self.damping * velocity[1]], -1.0, 1.0)


def make_jaco() -> ComposerEnv:
    """Make dm_control's task of reaching a site with the Jaco arm, from its own observables."""
    from dm_control import manipulation

    return ComposerEnv(manipulation.load(REACH))


class JacoReach:
    """Joint velocities that bring the hand straight to the target, by damped least squares.

    Args:
        gain: Share of the way commanded in a second [1/s].
        target_offset: By how much it misjudges where the target is (x, y, z) [m].
    """

    def __init__(self, gain: float = 2.0, target_offset: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        from dm_control import manipulation

        self.gain, self.target_offset = gain, np.array(target_offset)
        self._env = manipulation.load(REACH, seed=0)  # its model computes the Jacobian
        model = self._env.physics.model
        names = [model.id2name(i, "joint") for i in range(model.njnt)]
        joints = [i for i, name in enumerate(names) if name.startswith("jaco_arm/joint_")]
        self._angles, self._velocities = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self._hand = model.name2id("jaco_arm/jaco_hand/pinchsite", "site")
        self._limits = model.actuator_ctrlrange[: len(joints), 1].copy()
        self._fingers = np.zeros(model.nu - len(joints))

    def __call__(self, joints: Vector, target: Vector) -> Vector:
        """Return the joints' velocities and still fingers ``[9]`` [rad/s].

        Args:
            joints: Sines and cosines of the joints ``[1, 6, 2]``.
            target: Position of the target ``[1, 3]`` [m].
        """
        sines, cosines = joints.reshape(-1, 2).T
        model, data = self._env.physics.model.ptr, self._env.physics.data.ptr
        data.qpos[self._angles] = np.arctan2(sines, cosines)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacSite(model, data, jacobian, None, self._hand)
        j = jacobian[:, self._velocities]  # (3, 6)
        way = target[0] + self.target_offset - data.site_xpos[self._hand]
        arm = j.T @ np.linalg.solve(j @ j.T + DAMPING**2 * np.eye(3), self.gain * way)
        return np.concatenate([np.clip(arm, -self._limits, self._limits), self._fingers])
