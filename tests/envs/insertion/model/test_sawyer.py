from __future__ import annotations

import mujoco
import numpy as np
import pytest
from dm_control import mjcf

from rrl.envs import make_config
from rrl.envs.insertion.model.gripper import FINGER_TRAVEL, ParallelGripper
from rrl.envs.insertion.model.sawyer import LINKS, TOOL_DOWN, Sawyer
from rrl.envs.insertion.model.scene import compile_model
from rrl.envs.insertion.physics.start import StartState


def test_published_masses_ranges_and_torques() -> None:
    arm = Sawyer()
    physics = mjcf.Physics.from_mjcf_model(arm.mjcf_model)
    joints, links = physics.bind(arm.joints), physics.bind(arm.links)
    assert len(arm.joints) == 7
    np.testing.assert_allclose(links.mass, [link.mass for link in LINKS])
    np.testing.assert_allclose(joints.range, [link.range for link in LINKS])
    torques = physics.model.ptr.jnt_actfrcrange
    np.testing.assert_allclose(torques[:, 1], [80, 80, 40, 40, 9, 9, 9])
    np.testing.assert_allclose(links.inertia, [link.inertia for link in LINKS], rtol=1e-5)


def test_hand_points_down_in_the_published_posture() -> None:
    arm = Sawyer()
    physics = mjcf.Physics.from_mjcf_model(arm.mjcf_model)
    with physics.reset_context():
        physics.bind(arm.joints).qpos = TOOL_DOWN
    axes = physics.bind(arm.hand_site).xmat.reshape(3, 3)
    np.testing.assert_allclose(axes[:, 2], (0, 0, -1), atol=2e-3)
    wrist = physics.bind(arm.wrist_site).xmat.reshape(3, 3)
    np.testing.assert_allclose(wrist, np.eye(3), atol=2e-3)


def test_gravity_compensation_counts_against_the_torque_limits(variant: str) -> None:
    config = make_config(variant)
    model = compile_model(config)
    start = StartState(model, config)
    data = mujoco.MjData(model)
    start.hold(model, data, model.qpos0)
    data.qpos[:7] = start.home
    data.ctrl[:] = 1e3
    mujoco.mj_forward(model, data)
    limits = np.array([link.max_torque for link in LINKS])
    assert (np.abs(data.qfrc_actuator[:7]) <= limits + 1e-9).all()
    assert np.abs(data.qfrc_gravcomp[:7]).max() > 10


def test_gripper_rejects_a_block_wider_than_its_travel() -> None:
    with pytest.raises(ValueError, match="held_half_size: expected a block at most as wide"):
        ParallelGripper(opening=2 * FINGER_TRAVEL + 0.001)
