from __future__ import annotations

import math

import numpy as np
import pytest

from rrl.envs import make_config
from rrl.envs.insertion import quantities as q


def signals(
    tilt: float = 0.0, yaw: float = 0.0, tool: tuple = (0.6, 0.0, 0.05), substeps: int = 4
) -> dict[str, np.ndarray]:
    """A trace of one environment, both blocks turned by yaw, then toppled about their own y axis."""
    z_axis = (math.sin(tilt) * math.cos(yaw), math.sin(tilt) * math.sin(yaw), math.cos(tilt))
    y_axis = (-math.sin(yaw), math.cos(yaw), 0.0)
    one = {
        "tool_position": np.array(tool),
        "held_position": np.array(tool),
        "block_position": q.desired_block_positions(make_config("sim")),
        "block_z_axis": np.array([z_axis, z_axis]),
        "block_y_axis": np.array([y_axis, y_axis]),
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
    m = q.measure(trace, TARE)
    np.testing.assert_allclose(m.inclination, [[math.pi / 2] * 2])
    assert all(np.isfinite(field).all() for field in m)
    assert not q.success(m, make_config("sim")).any()


def test_wrench_is_tared_and_averaged_and_contact_is_the_peak() -> None:
    trace = signals()
    trace["wrist_force"][0, :, 2] = [6.0, 6.0, 2.0, 2.0]
    trace["contact_force"][0, :, 0] = [0.0, 9.0, 1.0, 0.0]
    m = q.measure(trace, TARE)
    assert m.wrench[0, 2] == pytest.approx(2.0)
    assert m.contact_force[0] == 9.0


def test_observation_layout() -> None:
    m = q.measure(signals(tilt=0.1, yaw=0.2, tool=(0.61, 0.02, 0.09)), TARE)
    for variant in ("sim", "real"):
        config = make_config(variant)
        values = q.observation(m, config)
        assert {name: v.shape[1] for name, v in values.items()} == q.observation_sizes(config)
        left_x = 0.6 - config.block_offset
        np.testing.assert_allclose(values["blocks"][0, :5], (left_x, 0, 0.04, 0.1, 0.2), atol=1e-9)
        np.testing.assert_allclose(values["blocks"][0, 10:], (0.61, 0.02, 0.09))
        np.testing.assert_allclose(values["goal"][0], (0.6, 0.0, 0.05))


def test_reward_is_the_papers() -> None:
    trace = signals(tilt=-0.2, yaw=0.3, tool=(0.6, 0.03, 0.09))
    trace["block_position"][..., 0, 1] += 0.04
    trace["block_position"][..., 1, 2] += 0.03
    m = q.measure(trace, TARE)
    config = make_config(
        "real", {"tilt_weight": 2.0, "displacement_weight": 3.0, "yaw_weight": 5.0}
    )
    terms = q.reward_terms(m, config)
    assert tuple(terms) == q.reward_term_names(config)
    expected = {"distance": -0.05, "tilt": -0.8, "displacement": -0.15, "yaw": -3.0}
    assert {name: float(term[0]) for name, term in terms.items()} == pytest.approx(expected)


def test_sim_has_no_terms_of_weight_zero() -> None:
    assert q.reward_term_names(make_config("sim")) == ("distance", "tilt")


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
    m = q.measure(signals(**changes), TARE)
    assert q.success(m, make_config("sim")).tolist() == [expected]
