from __future__ import annotations

import dataclasses
import math

import pytest

from rrl.envs import InsertionConfig, make_config
from rrl.envs.insertion.config import PRESETS


@pytest.mark.parametrize("variant", PRESETS)
def test_presets_are_valid(variant: str) -> None:
    assert make_config(variant) == PRESETS[variant]


def test_is_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        InsertionConfig().clearance = 1.0  # type: ignore[misc]


def test_unknown_variant_names_the_choices() -> None:
    with pytest.raises(ValueError, match=r"variant: expected one of \['real', 'sim'\], got 'reel'"):
        make_config("reel")


def test_unknown_setting_names_the_nearest_and_all() -> None:
    with pytest.raises(
        ValueError, match=r"action_scale.*got 'clearence' \(did you mean 'clearance'"
    ):
        make_config("sim", {"clearence": 0.1})


def test_takes_a_whole_config_and_lists() -> None:
    config = make_config(PRESETS["real"], {"yaw_choices": [0.0], "substeps": 10})
    assert config.yaw_choices == (0.0,)
    assert config.control_timestep == pytest.approx(0.02)


def test_yaw_range_takes_the_place_of_choices() -> None:
    config = make_config("real", {"yaw_range": 0.2})
    assert config.yaw_choices == ()
    assert config.max_yaw == 0.2


def test_derived_geometry() -> None:
    config = make_config("sim")
    assert config.goal == (0.6, 0.0, 0.05)
    assert config.block_offset == pytest.approx(0.042)
    assert make_config("real").max_yaw == pytest.approx(math.radians(20))
    left, right = config.block_goals
    assert left == pytest.approx((0.558, 0.0, 0.04)) and right == pytest.approx((0.642, 0.0, 0.04))


def test_reward_weights_that_are_not_named_stay() -> None:
    config = make_config("real", {"reward_weights": {"yaw": 0.0}})
    assert config.reward_weights == {"displacement": 0.1, "yaw": 0.0}


def test_checks_itself_without_make_config() -> None:
    with pytest.raises(ValueError, match="clearance"):
        InsertionConfig(clearance=-1.0)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"clearance": -0.001}, "clearance: expected greater than or equal to 0, got -0.001"),
        (
            {"held_half_size": (0.02, 0.0, 0.05)},
            r"held_half_size.1: expected greater than 0, got 0",
        ),
        ({"held_half_size": (0.02, 0.05)}, r"held_half_size.2: expected a value, got \(0.02"),
        ({"joint_stiffness": (1.0,)}, "joint_stiffness: expected at least 7 items"),
        ({"standing_mass": math.nan}, "standing_mass: expected a finite number, got nan"),
        ({"standing_mass": "heavy"}, "standing_mass: expected a valid number, got 'heavy'"),
        ({"controller": "magic"}, "controller: expected 'cartesian' or 'impedance', got 'magic'"),
        ({"blocks": "glued"}, "blocks: expected 'planar', 'free' or 'fixed'"),
        ({"substeps": 0}, "substeps: expected greater than or equal to 1, got 0"),
        ({"episode_length": 2.5}, "episode_length: expected a valid integer, got 2.5"),
        ({"chamfer": (0.05, 0.01)}, "chamfer: expected less than the sides"),
        ({"chamfer": (0.003, 0.0)}, "chamfer: expected two cuts"),
        ({"yaw_range": 0.1, "yaw_choices": (0.0, 5.0)}, "yaw_range: expected 0 beside yaw_choices"),
        ({"yaw_range": 2.0}, "yaw_choices: expected below pi/2, got 2.000 rad"),
        (
            {"yaw_range": 1.5, "standing_half_size": (0.02, 0.06, 0.04)},
            "expected standing blocks that do not overlap",
        ),
        ({"start_height": 0.05}, "start_height: expected more than the blocks' height 0.08"),
        ({"goal_xy": (1.2, 0.0)}, r"goal_xy: expected within reach.*got \(1.2"),
        ({"goal_xy": (0.1, 0.0)}, "goal_xy: expected within reach"),
        ({"reward_weights": {"tilt": -1.0}}, "reward_weights.tilt: expected greater than or equal"),
        ({"position_tolerance": 0.0}, "position_tolerance: expected greater than 0, got 0"),
    ],
)
def test_bad_values_are_explained(overrides: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_config("sim", overrides)
