from __future__ import annotations

import dataclasses
import math

import pytest

from rrl.envs import InsertionConfig, make_config
from rrl.envs.insertion.config import PRESETS


@pytest.mark.parametrize("variant", PRESETS)
def test_presets_are_valid(variant: str) -> None:
    assert PRESETS[variant].validate() is PRESETS[variant]


def test_is_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        InsertionConfig().clearance = 1.0  # type: ignore[misc]


def test_unknown_variant_names_the_choices() -> None:
    with pytest.raises(ValueError, match=r"unknown variant 'reel'.*\['real', 'sim'\]"):
        make_config("reel")


def test_unknown_setting_names_the_nearest_and_all() -> None:
    with pytest.raises(ValueError, match=r"clearence.*did you mean 'clearance'.*action_scale"):
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


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"clearance": -0.001}, "clearance must not be negative"),
        ({"held_half_size": (0.02, 0.0, 0.05)}, "held_half_size must be positive"),
        ({"held_half_size": (0.02, 0.05)}, "held_half_size needs 3 numbers"),
        ({"joint_stiffness": (1.0,)}, "joint_stiffness needs 7 numbers"),
        ({"standing_mass": math.nan}, "standing_mass must be finite"),
        ({"standing_mass": "heavy"}, "standing_mass must be finite"),
        ({"controller": "magic"}, r"controller must be one of \['cartesian', 'impedance'\]"),
        ({"blocks": "glued"}, "blocks must be one of"),
        ({"substeps": 0}, "substeps must be a whole number"),
        ({"episode_length": 2.5}, "episode_length must be a whole number"),
        ({"chamfer": (0.05, 0.01)}, "cuts away a whole side"),
        ({"chamfer": (0.003, 0.0)}, "give both cuts"),
        ({"yaw_range": 0.1, "yaw_choices": (0.0, 5.0)}, "exclude each other"),
        ({"yaw_range": 2.0}, "below pi/2"),
        ({"yaw_range": 1.5, "standing_half_size": (0.02, 0.06, 0.04)}, "they would overlap"),
        ({"start_height": 0.05}, "into the standing blocks"),
        ({"goal_xy": (1.2, 0.0)}, "out of the arm's reach"),
        ({"goal_xy": (0.1, 0.0)}, "out of the arm's reach"),
        ({"position_tolerance": 0.0}, "position_tolerance must be positive"),
    ],
)
def test_bad_values_are_explained(overrides: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_config("sim", overrides)
