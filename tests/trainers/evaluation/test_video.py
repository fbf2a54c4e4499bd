"""The video shows the frozen episode that the evaluation counted."""

from functools import partial

import imageio.v3 as iio
import numpy as np
import pytest
from imageio_ffmpeg import count_frames_and_secs

from pixel_envs import PixelPoint
from rrl.controllers import ProportionalController, ZeroController
from rrl.envs import InsertionEnv, RenderingUnavailable, render_states
from rrl.trainers.environment import EnvironmentFactory, Input
from rrl.trainers.evaluation.rollout import run_episodes, zero_residual
from rrl.trainers.evaluation.video import record, render_comparison

SIZE = {"width": 64, "height": 48, "fps": 20}


class FilmedPoint(PixelPoint):
    """One that says where it is."""

    def physics_state(self):
        return self._position.numpy()


@pytest.fixture
def environment():
    return EnvironmentFactory(
        base=partial(InsertionEnv, variant="real", episode_length=4),
        controller=partial(ProportionalController, gain=0.5, clip=0.5, unit=0.02),
        inputs={"goal": Input()},
        max_episode_steps=50,
    )


def test_the_recorded_episode_is_the_evaluated_one(environment):
    env = environment.make(1)
    played = record(env, zero_residual(env), seed=7, max_steps=50)
    assert len(played.states) == len(played.outcomes) == 5
    batch = environment.make(3)
    result = run_episodes(batch, zero_residual(batch), 3, seed=5, max_steps=50)
    assert result.lengths[2] == 4
    assert (batch.base_env.physics_state()[2] == played.states[-1][0]).all()


@pytest.mark.parametrize("ending", ["mp4", "gif"])
def test_both_halves_are_filmed(environment, ending, tmp_path):
    env = environment.make(1)
    try:
        out = render_comparison(
            environment, zero_residual(env), render_states, 5, tmp_path / f"episode.{ending}", SIZE
        )
    except RenderingUnavailable as error:
        pytest.skip(str(error))
    if ending == "gif":
        assert iio.imread(out).shape[1:] == (48, 128, 3)
    else:
        frames, seconds = count_frames_and_secs(out)
        assert frames == 5 + SIZE["fps"]  # the episode, and its last frame for a second
        assert seconds == pytest.approx(frames / SIZE["fps"])
    picture = iio.imread(out.with_suffix(".png"))
    assert picture.shape == (48, 128, 3)
    assert picture[10:].std() > 10  # not black


def grey(env, states, width, height):
    """A scene without OpenGL."""
    return np.full((len(states), height, width, 3), 128, dtype=np.uint8)


@pytest.mark.parametrize("channels", ["last", "first"])
@pytest.mark.parametrize("cameras", [0, 1, 2])
def test_what_the_policy_sees_stands_beside_the_scene(channels, cameras, tmp_path):
    names = ["pixels", *(f"pixels_{i}" for i in range(1, cameras))][:cameras]
    factory = EnvironmentFactory(
        base=lambda num_envs: FilmedPoint([num_envs], channels=channels, cameras=max(1, cameras)),
        controller=partial(ProportionalController, gain=0.5),
        inputs={"goal": Input(), **{name: Input() for name in names}},
        max_episode_steps=6,
    )
    env = factory.make(1)
    policy = zero_residual(env)
    size = {"width": 64, "height": 64, "fps": 20}
    film = render_comparison(factory, policy, grey, 5, tmp_path / "film.gif", size)
    last = iio.imread(film.with_suffix(".png"))
    assert last.shape == (64, 2 * (64 + 32 * bool(cameras)), 3)
    seen = record(env, policy, 5, 6, factory.read_inputs(env)).views
    assert [len(pictures) for pictures in seen] == [cameras] * 7
    if cameras:
        pixels = seen[-1][-1].repeat(2, axis=0).repeat(2, axis=1)
        np.testing.assert_array_equal(last[32:, 64:96], pixels)
        assert pixels[..., :2].max((0, 1)).min() > 50  # red the point, green the goal


def test_an_environment_without_a_state_to_draw_is_named(environment):
    factory = EnvironmentFactory(
        PixelPoint, ZeroController, inputs=["goal"], batching="serial", max_episode_steps=6
    )
    env = factory.make()
    with pytest.raises(
        TypeError, match=r"base: expected a method physics_state\(\), .* PixelPoint .*mujoco_state"
    ):
        record(env, zero_residual(env), seed=5, max_steps=6)
