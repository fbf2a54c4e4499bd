from __future__ import annotations

import copy
import math

import mujoco
import numpy as np
import pytest

from rrl.envs import make_config
from rrl.envs.insertion.model.scene import compile_model
from rrl.envs.insertion.physics.start import Episode, StartState, draw_episode


def test_draws_are_within_the_settings() -> None:
    rng = np.random.default_rng(0)
    discrete = make_config("real")
    episodes = [draw_episode(discrete, rng) for _ in range(300)]
    values = {round(math.degrees(angle)) for episode in episodes for angle in episode.yaw}
    assert values == {-20, 0, 20}
    uniform = make_config("sim", {"yaw_range": 0.3, "start_range": (0.01, 0.0, 0.02)})
    episodes = [draw_episode(uniform, rng) for _ in range(300)]
    yaw = np.array([episode.yaw for episode in episodes])
    offset = np.array([episode.offset for episode in episodes])
    assert 0.29 < np.abs(yaw).max() <= 0.3
    assert (np.abs(offset).max(axis=0) <= (0.01, 0.0, 0.02)).all()
    assert np.abs(offset).max(axis=0)[2] > 0.018
    elsewhere = make_config("real", {"place_range": (0.03, 0.01)})
    place = np.abs([draw_episode(elsewhere, rng).place for _ in range(300)])
    assert (place.max(axis=0) <= (0.03, 0.01)).all() and (place.max(axis=0) > (0.028, 0.009)).all()


def test_a_place_of_its_own_leaves_the_other_draws_of_an_episode_alone() -> None:
    here, elsewhere = (
        draw_episode(make_config("real", {"place_range": place}), np.random.default_rng(1))
        for place in ((0.0, 0.0), (0.03, 0.03))
    )
    np.testing.assert_array_equal(here.offset, elsewhere.offset)
    np.testing.assert_array_equal(here.yaw, elsewhere.yaw)
    assert (here.place == 0).all() and (elsewhere.place != 0).all()


@pytest.mark.parametrize("blocks", ["planar", "free", "fixed"])
def test_start_is_where_it_should_be_and_at_rest(variant: str, blocks: str) -> None:
    config = make_config(variant, {"blocks": blocks, "place_range": (0.03, 0.02)})
    model = compile_model(config)
    start = StartState(model, config)
    data = mujoco.MjData(model)
    episode = Episode(
        yaw=np.array([0.3, -0.2]),
        offset=np.array([0.01, -0.008, 0.005]),
        place=np.array([0.03, -0.02]),
    )
    start.set_blocks(model, episode.yaw, episode.place)
    start.hold(model, data, start.qpos(model, episode))
    signals = start.layout.views(data.sensordata)
    nominal = np.add(config.goal, (0, 0, config.start_height))
    np.testing.assert_allclose(signals["tool_position"], nominal + episode.offset, atol=5e-4)
    axes = signals["block_y_axis"]
    np.testing.assert_allclose(np.arctan2(-axes[:, 0], axes[:, 1]), episode.yaw, atol=1e-9)
    moved = np.array(config.block_goals)[:, :2] + episode.place
    np.testing.assert_allclose(signals["block_position"][:, :2], moved, atol=1e-6)
    gap = np.add(config.goal, (*episode.place, 0.0))
    np.testing.assert_allclose(signals["goal_position"], gap, atol=1e-12)
    before = data.sensordata.copy()
    for _ in range(100):
        mujoco.mj_step(model, data)
    names = ("tool_position", "block_position", "block_z_axis")
    for name in names:
        drift = start.layout.views(data.sensordata)[name] - start.layout.views(before)[name]
        assert np.abs(drift).max() < 2e-4, name


def test_tare_is_the_weight_of_gripper_and_block() -> None:
    config = make_config("sim")
    model = compile_model(config)
    weight = 9.81 * (0.3 + config.held_mass)
    np.testing.assert_allclose(StartState(model, config).tare[2], weight, rtol=1e-3)


def test_unreachable_start_says_so() -> None:
    config = copy.copy(make_config("sim"))
    object.__setattr__(config, "goal_xy", (1.3, 0.0))  # past the config's own check
    with pytest.raises(ValueError, match=r"goal_xy: expected a start that the arm reaches"):
        StartState(compile_model(config), config)
