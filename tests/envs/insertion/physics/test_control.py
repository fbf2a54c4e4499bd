from __future__ import annotations

import mujoco
import numpy as np
import pytest

from rrl.envs import make_config
from rrl.envs.insertion.model.scene import compile_model
from rrl.envs.insertion.physics.control import check_action, jacobian, orientation_error, set_points
from rrl.envs.insertion.physics.start import Episode, StartState


@pytest.fixture(scope="module")
def arm() -> tuple[mujoco.MjModel, mujoco.MjData, StartState]:
    config = make_config("real")
    model = compile_model(config)
    start = StartState(model, config)
    data = mujoco.MjData(model)
    start.hold(model, data, model.qpos0)
    data.qpos[:7] = start.home + np.linspace(-0.1, 0.1, 7)
    mujoco.mj_forward(model, data)
    return model, data, start


def test_jacobian_is_mujocos(arm: tuple) -> None:
    model, data, start = arm
    site = model.site("sawyer/gripper/held_block/center").id
    expected = np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, expected[:3], expected[3:], site)
    ours = jacobian(start.layout.views(data.sensordata[None]))[0]
    np.testing.assert_allclose(ours, expected[:, :7], atol=1e-12)


def test_joint_step_moves_the_tool_and_straightens_it(arm: tuple) -> None:
    model, _, start = arm
    config = start.config
    data = mujoco.MjData(model)
    data.qpos[:7] = start.home + np.linspace(-0.02, 0.02, 7)
    mujoco.mj_forward(model, data)
    before = start.layout.views(data.sensordata[None].copy())
    action = np.array([[0.3, -0.2, 0.1]])
    data.qpos[:7] = set_points(before, action, config, start.home)[0]
    mujoco.mj_forward(model, data)
    after = start.layout.views(data.sensordata[None])
    moved = (after["tool_position"] - before["tool_position"])[0]
    np.testing.assert_allclose(moved, config.action_scale * action[0], atol=5e-4)
    left = (1 - config.ik_rotation_gain) * orientation_error(before)[0]
    np.testing.assert_allclose(
        orientation_error(after)[0], left, atol=4e-4
    )  # the step's second order: 0.02^2
    assert np.abs(left).max() > 5e-3


@pytest.mark.parametrize(("base_height", "low", "high"), [(-0.35, 0.0, 0.15), (0.0, 0.5, 1.0)])
def test_pressing_at_shoulder_height_does_not_push_sideways(
    base_height: float, low: float, high: float
) -> None:
    config = make_config("real", {"base_height": base_height})
    start = StartState(compile_model(config), config)
    data = mujoco.MjData(model := compile_model(config))
    start.hold(model, data, start.qpos(model, Episode(yaw=np.zeros(2), offset=np.zeros(3))))
    jac = jacobian(start.layout.views(data.sensordata[None]))[0]
    compliance = jac / np.asarray(config.joint_stiffness) @ jac.T  # (6, 6)
    assert low <= abs(compliance[0, 2]) / compliance[2, 2] <= high


def test_redundant_joint_returns_home(arm: tuple) -> None:
    model, _, start = arm
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    data.qpos[:7] = start.home + rng.normal(0, 0.1, 7)
    for _ in range(300):
        mujoco.mj_forward(model, data)
        signals = start.layout.views(data.sensordata[None])
        target = np.add(start.config.goal, (0, 0, start.config.start_height))
        error = (target - signals["tool_position"]) / start.config.action_scale
        action = np.clip(error, -1, 1)
        data.qpos[:7] = set_points(signals, action, start.config, start.home)[0]
    np.testing.assert_allclose(data.qpos[:7], start.home, atol=1e-3)


def test_cartesian_set_point_is_relative_to_the_measured_position(arm: tuple) -> None:
    _, data, start = arm
    config = make_config("sim")
    signals = start.layout.views(data.sensordata[None])
    controls = set_points(signals, np.array([[1.0, 0.0, -0.5]]), config, start.home)
    expected = signals["tool_position"][0] - config.goal + (0.02, 0.0, -0.01)
    np.testing.assert_allclose(controls[0], (*expected, 0, 0, 0))


def test_actions_are_clipped() -> None:
    np.testing.assert_array_equal(check_action(np.array([[2.0, -3.0, 0.5]]), 1), [[1, -1, 0.5]])


@pytest.mark.parametrize("shape", [(3,), (2, 3), (1, 4)])
def test_wrong_shape_says_what_it_needs(shape: tuple) -> None:
    with pytest.raises(ValueError, match=r"action: expected shape \(1, 3\).*got"):
        check_action(np.zeros(shape), 1)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_not_finite_names_the_slots(bad: float) -> None:
    action = np.zeros((4, 3))
    action[[1, 3], 2] = bad
    with pytest.raises(ValueError, match=r"slot\(s\) \[1, 3\]"):
        check_action(action, 4)
