from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from torchrl.envs.utils import check_env_specs

from rrl.envs import InsertionEnv, load, make_config
from rrl.envs.insertion import quantities as q


def signals(
    tilt: float = 0.0, yaw: float = 0.0, tool: tuple = (0.6, 0.0, 0.05), substeps: int = 4
) -> dict[str, np.ndarray]:
    """A trace of one environment, both blocks turned by yaw, then toppled about their y axis."""
    z_axis = (math.sin(tilt) * math.cos(yaw), math.sin(tilt) * math.sin(yaw), math.cos(tilt))
    y_axis = (-math.sin(yaw), math.cos(yaw), 0.0)
    one = {
        "tool_position": np.array(tool),
        "held_position": np.array(tool),
        "block_position": np.array(make_config("sim").block_goals),
        "block_z_axis": np.array([z_axis, z_axis]),
        "block_y_axis": np.array([y_axis, y_axis]),
        "goal_position": np.array(make_config("sim").goal),
        "wrist_force": np.array([0.0, 0.0, 5.0]),
        "wrist_torque": np.zeros(3),
        "contact_force": np.array([3.0]),
    }
    return {
        name: np.broadcast_to(value, (1, substeps, *value.shape)).copy()
        for name, value in one.items()
    }


TARE = np.array([0.0, 0.0, 6.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("tilt", [-1.2, -0.05, 0.0, 0.3, 1.5])
@pytest.mark.parametrize("yaw", [-1.0, 0.0, 0.349])
def test_angles(tilt: float, yaw: float) -> None:
    m = q.measure(signals(tilt=tilt, yaw=yaw), TARE)
    np.testing.assert_allclose(m.tilt, [[tilt, tilt]], atol=1e-12)
    np.testing.assert_allclose(m.yaw, [[yaw, yaw]], atol=1e-12)
    np.testing.assert_allclose(m.inclination, [[abs(tilt)] * 2], atol=1e-12)


def test_inclination_sees_a_block_lying_on_its_side() -> None:
    trace = signals()
    trace["block_z_axis"][:] = (0.0, 1.0, 0.0)
    trace["block_y_axis"][:] = (0.0, 0.0, -1.0)
    out = q.evaluate(trace, TARE, make_config("sim"))
    assert out["metrics/tilt"].item() == pytest.approx(math.pi / 2)
    assert all(np.isfinite(value).all() for value in out.values())
    assert not out["success"].any()


def test_wrench_is_tared_and_averaged_and_contact_is_the_peak() -> None:
    trace = signals()
    trace["wrist_force"][0, :, 2] = [6.0, 6.0, 2.0, 2.0]
    trace["contact_force"][0, :, 0] = [0.0, 9.0, 1.0, 0.0]
    out = q.evaluate(trace, TARE, make_config("sim"))
    assert out["wrench"][0, 2] == pytest.approx(2.0)
    assert out["metrics/contact_force"].item() == 9.0


@pytest.mark.parametrize("variant", ["sim", "real"])
def test_observation_layout(variant: str) -> None:
    config = make_config(variant)
    out = q.evaluate(signals(tilt=0.1, yaw=0.2, tool=(0.61, 0.02, 0.09)), TARE, config)
    sizes = q.observation_sizes(config)
    assert {name: out[name].shape for name in sizes} == {n: (1, size) for n, size in sizes.items()}
    assert [*out] == [*q.output_names(config), "reward"]
    left_x = 0.6 - config.block_offset
    np.testing.assert_allclose(out["blocks"][0, :5], (left_x, 0, 0.04, 0.1, 0.2), atol=1e-9)
    np.testing.assert_allclose(out["blocks"][0, 10:], (0.61, 0.02, 0.09))
    np.testing.assert_allclose(out["goal"][0], (0.6, 0.0, 0.05))


def test_reward_is_the_papers() -> None:
    trace = signals(tilt=-0.2, yaw=0.3, tool=(0.6, 0.03, 0.09))
    trace["block_position"][..., 0, 1] += 0.04
    trace["block_position"][..., 1, 2] += 0.03
    weights = {"tilt": 2.0, "displacement": 3.0, "yaw": 5.0}
    out = q.evaluate(trace, TARE, make_config("real", {"reward_weights": weights}))
    expected = {"distance": -0.05, "tilt": -0.8, "displacement": -0.15, "yaw": -3.0}
    terms = {name: out[f"reward_terms/{name}"].item() for name in expected}
    assert terms == pytest.approx(expected)
    assert out["reward"].item() == pytest.approx(sum(expected.values()))


def test_the_gap_and_not_where_the_robot_believes_it_is_the_goal() -> None:
    config = make_config("real", {"place_range": (0.03, 0.0)})
    trace = signals(tool=(0.63, 0.0, 0.05))
    for name in ("goal_position", "block_position"):
        trace[name][..., 0] += 0.03
    out = q.evaluate(trace, TARE, config)
    assert out["success"].item()
    assert out["reward_terms/distance"].item() == out["reward_terms/displacement"].item() == 0
    np.testing.assert_allclose(out["goal"][0], (0.6, 0.0, 0.05))


def test_sim_has_no_terms_of_weight_zero() -> None:
    terms = [n for n in q.output_names(make_config("sim")) if n.startswith("reward_terms")]
    assert terms == ["reward_terms/distance", "reward_terms/tilt"]


def test_a_new_quantity_is_one_entry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(q.METRICS, "height", lambda m, config: m.end_effector[:, 2])
    monkeypatch.setitem(
        q.REWARD_TERMS, "effort", q.RewardTerm(2.0, lambda m, config: m.wrench[:, 2])
    )
    monkeypatch.setitem(
        q.OBSERVATIONS, "tool_xy", q.Observation(2, lambda m, c: m.end_effector[:, :2])
    )
    env = InsertionEnv("sim", num_envs=2)
    check_env_specs(env)
    last = env.rollout(3)[:, -1]["next"]
    torch.testing.assert_close(last["metrics", "height"], last["end_effector_position"][:, 2:])
    torch.testing.assert_close(last["reward_terms", "effort"], -2 * last["wrench"][:, 2:3])
    torch.testing.assert_close(last["tool_xy"], last["end_effector_position"][:, :2])
    assert {"metrics/height", "reward_terms/effort"} <= set(
        load("insertion-sim").reset().observation
    )


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, True),
        ({"tilt": 0.09}, True),
        ({"tilt": -0.11}, False),
        ({"tool": (0.611, 0.0, 0.05)}, True),
        ({"tool": (0.6, 0.0, 0.063)}, False),
        ({"yaw": 0.5}, True),
    ],
)
def test_success(changes: dict, expected: bool) -> None:
    out = q.evaluate(signals(**changes), TARE, make_config("sim"))
    assert out["success"].tolist() == [[expected]]


@pytest.mark.parametrize("name", ["insertion-sim", "shared/tracked", "insertion-pixels"])
def test_the_yaml_declares_every_metric(name: str) -> None:
    path = Path(__file__).parents[3] / "configs" / "env" / f"{name}.yaml"
    declared = yaml.safe_load(path.read_text())["metrics"]
    assert set(declared) == set(q.METRICS)
    assert all(set(entry) >= {"unit", "reduce"} for entry in declared.values())
