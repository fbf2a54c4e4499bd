"""The state in which episodes start: found once, then drawn around at every reset."""

from __future__ import annotations

import math
from typing import NamedTuple

import mujoco
import numpy as np

from ..config import NUM_JOINTS, InsertionConfig
from ..model.sawyer import TOOL_DOWN
from .control import jacobian, orientation_error, set_points
from .signals import SignalLayout

SETTLE_TIME = 0.5
ARM_JOINTS = tuple(f"sawyer/right_j{index}" for index in range(NUM_JOINTS))
BLOCK_BODIES = ("left_block/", "right_block/")
GAP_SITE = "gap"
Random = np.random.Generator | np.random.RandomState


class Episode(NamedTuple):
    """The random part of a reset."""

    yaw: np.ndarray
    """[2] of the left and right standing block, rad."""
    offset: np.ndarray
    """[3] of the end effector from its nominal start, m."""
    place: np.ndarray = np.zeros(2)
    """[2] of blocks and gap from where the robot believes them, m."""


def draw_episode(config: InsertionConfig, random: Random) -> Episode:
    """Draw the next episode; takes five numbers from ``random``, and two more for a place."""
    unit = np.asarray(random.uniform(0.0, 1.0, 5))
    if config.yaw_choices:
        index = (unit[:2] * len(config.yaw_choices)).astype(int)
        yaw = np.radians(np.asarray(config.yaw_choices))[index]
    else:
        yaw = config.yaw_range * (2 * unit[:2] - 1)
    offset = np.asarray(config.start_range) * (2 * unit[2:] - 1)
    if not any(config.place_range):
        return Episode(yaw, offset)
    place = np.asarray(config.place_range) * (2 * np.asarray(random.uniform(0.0, 1.0, 2)) - 1)
    return Episode(yaw, offset, place)


class StartState:
    """Nominal start of an episode: arm by inverse kinematics, blocks settled under gravity.

    Attributes:
        home: Joint positions with the tool at its nominal start, [7] [rad].
        tare: Wrist reading of the unloaded tool at rest, [6] [N] and [N m].
        yaw_in_model: Whether the standing blocks' yaw is part of the model (``body_quat``), which
            keeps the paper's three degrees of freedom, rather than of the state, and so is their
            place.
    """

    def __init__(self, model: mujoco.MjModel, config: InsertionConfig) -> None:
        self.config = config
        self.layout = SignalLayout(model)
        self.yaw_in_model = config.blocks != "free"
        self._arm = np.array([model.joint(name).qposadr[0] for name in ARM_JOINTS])
        self._body_ids = [model.body(name).id for name in BLOCK_BODIES]
        self._gap = model.site(GAP_SITE).id
        self._qpos = model.qpos0.copy()
        self._qpos[self._arm] = TOOL_DOWN
        data = mujoco.MjData(model)
        self.home = self._solve_posture(model, data)
        self._qpos[self._arm] = self.home
        self._settle(model, data)
        self.hold(model, data, self._qpos)
        signals = self.layout.views(data.sensordata[None])
        self.tare = np.concatenate((signals["wrist_force"][0], signals["wrist_torque"][0]))
        self._inverse = np.linalg.pinv(jacobian(signals)[0])[:, :3]  # (7, 3)

    def _solve_posture(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        config = self.config
        target = np.array(config.goal) + np.array((0.0, 0.0, config.start_height))
        qpos = self._qpos.copy()
        for iteration in range(200):
            forward(model, data, qpos)
            signals = self.layout.views(data.sensordata[None])
            offset = target - signals["tool_position"][0]
            error = np.concatenate((offset, orientation_error(signals)[0]))
            if np.abs(error).max() < 1e-9:
                return qpos[self._arm].copy()
            error[:3] *= min(1.0, 0.1 / (np.linalg.norm(error[:3]) + 1e-12))
            jac = jacobian(signals)[0]
            inverse = jac.T @ np.linalg.inv(jac @ jac.T + 1e-6 * np.eye(6))
            # The pull towards a comfortable posture fades, so that the iteration ends.
            posture = 0.2 * 0.9**iteration * (np.array(TOOL_DOWN) - qpos[self._arm])
            qpos[self._arm] += posture + inverse @ (error - jac @ posture)
        raise ValueError(
            "goal_xy: expected a start that the arm reaches with the tool pointing down, got "
            f"{target.round(3).tolist()}; bring goal_xy nearer or lower start_height"
        )

    def _settle(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Let the blocks sink into the contact, and keep their height."""
        self.hold(model, data, self._qpos)
        for _ in range(round(SETTLE_TIME / self.config.physics_timestep)):
            mujoco.mj_step(model, data)
        if self.config.blocks != "fixed":
            for name in BLOCK_BODIES:
                height = self._first_address(model, name) + 2
                self._qpos[height] = data.qpos[height]

    def hold(self, model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> None:
        """Put ``data`` at rest in ``qpos`` with the arm's set point where the arm is."""
        forward(model, data, qpos)
        data.ctrl[:] = self.controls(data.sensordata[None], np.zeros((1, 3)))[0]
        mujoco.mj_forward(model, data)

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData, episode: Episode) -> None:
        """Put ``model`` and ``data`` at the start of ``episode``."""
        self.set_blocks(model, episode.yaw, episode.place)
        self.hold(model, data, self.qpos(model, episode))

    def controls(self, sensordata: np.ndarray, action: np.ndarray) -> np.ndarray:
        """Return actuator controls [B, nu] for actions [B, 3], as ``sensordata`` [B, n] is now."""
        return set_points(self.layout.views(sensordata), action, self.config, self.home)

    def _first_address(self, model: mujoco.MjModel, body: str) -> int:
        """Return where in qpos a standing block's x lies; y and z follow."""
        return int(model.jnt_qposadr[model.body(body).jntadr[0]])

    def qpos(self, model: mujoco.MjModel, episode: Episode) -> np.ndarray:
        """Return positions [nq] at the start of ``episode``; velocities are zero.

        The offset of the end effector goes through the Jacobian at the nominal start, which is
        exact to a fraction of a millimeter for the distances in question.
        """
        qpos = self._qpos.copy()
        qpos[self._arm] += self._inverse @ episode.offset
        if not self.yaw_in_model:
            for name, yaw in zip(BLOCK_BODIES, episode.yaw, strict=True):
                start = self._first_address(model, name)
                qpos[start : start + 2] += episode.place
                qpos[start + 3 : start + 7] = yaw_quaternion(yaw)
        return qpos

    def set_blocks(self, model: mujoco.MjModel, yaw: np.ndarray, place: np.ndarray) -> None:
        """Write yaw [2] and place [2] of the standing blocks into the model where they belong."""
        if self.yaw_in_model:
            for body, angle in zip(self._body_ids, yaw, strict=True):
                model.body_quat[body] = yaw_quaternion(angle)
        if not any(self.config.place_range):
            return
        model.site_pos[self._gap, :2] = self.config.goal_xy + place
        if self.yaw_in_model:
            centers = np.asarray(self.config.block_goals)[:, :2] + place  # (2, 2)
            model.body_pos[self._body_ids, :2] = centers


def forward(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> None:
    """Put ``data`` at rest in ``qpos`` and compute its sensors, without warm start."""
    mujoco.mj_resetData(model, data)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)


def yaw_quaternion(yaw: float) -> tuple[float, float, float, float]:
    """Return the rotation by ``yaw`` about the vertical, wxyz."""
    return (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
