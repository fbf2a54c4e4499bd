"""The insertion task with a camera, drawn by a real backend."""

from __future__ import annotations

import copy
import io

import numpy as np
import pytest
import torch
from torchrl.envs import ParallelEnv
from torchrl.envs.utils import check_env_specs

from insertion_helpers import act, assert_same, random_actions
from rrl.envs import InsertionEnv, InsertionPixelsEnv, RenderingUnavailable, opengl

DOWN = torch.tensor([0.0, 0.0, -1.0])


@pytest.fixture(scope="module", autouse=True)
def backend() -> str:
    try:
        return opengl.find_backend()
    except RenderingUnavailable as error:
        pytest.skip(str(error))


def pictures(steps: int = 8, **settings: object) -> np.ndarray:
    """The last pictures [2, size, size, 3] of two slots that move down for some steps."""
    env = InsertionPixelsEnv(num_envs=2, seed=3, **settings)
    td = env.reset()
    for _ in range(steps):
        td = act(env, DOWN)
    env.close()
    return td["pixels"].numpy().astype(int)


def difference(left: np.ndarray, right: np.ndarray) -> float:
    return float(np.abs(left - right).mean())


@pytest.mark.parametrize("num_envs", [1, 3])
def test_check_env_specs(variant: str, num_envs: int) -> None:
    env = InsertionPixelsEnv(variant, num_envs=num_envs, picture_size=48)
    check_env_specs(env)
    spec = env.observation_spec["pixels"]
    assert spec.dtype == torch.uint8 and spec.shape == (num_envs, 48, 48, 3)
    sizes = InsertionPixelsEnv.check_arguments(variant, picture_size=48)
    assert sizes["pixels"] == 48 * 48 * 3


def test_all_but_the_picture_is_the_task_without_a_camera(variant: str) -> None:
    seeing = InsertionPixelsEnv(variant, num_envs=2, seed=1)
    blind = InsertionEnv(variant, num_envs=2, seed=1)
    assert_same(seeing.reset().exclude("pixels"), blind.reset())
    for action in random_actions(10, 2):
        assert_same(act(seeing, action).exclude("pixels"), act(blind, action))


def test_a_picture_shows_its_own_slot_as_it_stands(variant: str) -> None:
    """Motion and yaw are in it, and neighbors, earlier pictures and other cameras are not."""
    batch = InsertionPixelsEnv(variant, num_envs=3, seed=5, place_range=(0.03, 0.03))
    alone = [InsertionPixelsEnv(variant, seed=5 + i, place_range=(0.03, 0.03)) for i in range(3)]
    first = batch.reset()["pixels"]
    assert torch.equal(first, torch.cat([env.reset()["pixels"] for env in alone]))
    assert len({picture.numpy().tobytes() for picture in first}) == 3
    for action in random_actions(8, 3):
        together = act(batch, action)["pixels"]
        apart = [act(env, action[i])["pixels"] for i, env in enumerate(alone)]
        assert torch.equal(together, torch.cat(apart))
    assert (together != first).flatten(1).any(1).all()
    assert together.float().std() > 20  # neither black nor blank


def test_slots_that_do_not_step_or_reset_show_what_they_showed() -> None:
    env = InsertionPixelsEnv(num_envs=3)
    env.reset()
    before = act(env, DOWN)
    reset = env.reset(
        before.exclude("reward").set("_reset", torch.tensor([[False], [True], [False]]))
    )
    same = [torch.equal(reset["pixels"][i], before["pixels"][i]) for i in range(3)]
    assert same == [True, False, True]


def test_state_dict_goes_on_in_the_middle_of_an_episode() -> None:
    env = InsertionPixelsEnv("sim", num_envs=2, seed=1, yaw_range=0.3, place_range=(0.03, 0.03))
    env.reset()
    actions = random_actions(12, 2)
    for action in actions[:5]:
        act(env, action)
    file = io.BytesIO()
    torch.save(copy.deepcopy(env.state_dict()), file)
    file.seek(0)
    other = InsertionPixelsEnv("sim", num_envs=2, seed=9, yaw_range=0.3, place_range=(0.03, 0.03))
    other.reset()
    other.load_state_dict(torch.load(file, weights_only=False))
    for action in actions[5:]:
        assert_same(act(env, action), act(other, action))
    assert_same(env.reset(), other.reset())


@pytest.mark.slow
def test_a_worker_draws_too() -> None:
    workers = ParallelEnv(1, InsertionPixelsEnv, mp_start_method="spawn", serial_for_single=False)
    workers.set_seed(5)
    assert workers.reset()["pixels"].float().std() > 20
    workers.close()


@pytest.mark.parametrize(
    "disturbance",
    [
        {"light_shift": (0.0, 2.5, 0.0)},
        {"light_shift": (1.0, 1.0, 0.0)},
        {"camera_shift": (0.02, 0.0, 0.0)},
        {"camera_shift": (0.0, 0.0, 0.02)},
        {"camera": "closeup"},
    ],
    ids=str,
)
def test_disturbances_change_the_picture_and_nothing_else(disturbance: dict) -> None:
    assert difference(pictures(), pictures(**disturbance)) > 2
    disturbed, plain = (InsertionPixelsEnv(seed=3, **given) for given in (disturbance, {}))
    assert_same(disturbed.reset().exclude("pixels"), plain.reset().exclude("pixels"))
    assert_same(act(disturbed, DOWN).exclude("pixels"), act(plain, DOWN).exclude("pixels"))


def test_a_shifted_camera_moves_the_picture_against_its_shift() -> None:
    plain, shifted = pictures(0)[0], pictures(0, camera_shift=(0.02, 0.0, 0.0))[0]
    moves = {dx: difference(np.roll(plain, dx, axis=1), shifted) for dx in range(-8, 9)}
    assert -6 <= min(moves, key=lambda dx: moves[dx]) <= -2  # pixels: to the left


def test_bad_settings_are_named() -> None:
    with pytest.raises(ValueError, match=r"camera: expected one of .*'gap'.*got 'top'"):
        InsertionPixelsEnv(camera="top")
    with pytest.raises(ValueError, match=r"picture_size: .*greater than or equal to 8, got 4"):
        InsertionPixelsEnv(picture_size=4)
    with pytest.raises(ValueError, match="camera_shift"):
        InsertionPixelsEnv.check_arguments(camera_shift=(0.02, 0.0))
    with pytest.raises(ValueError, match=r"light_shift.*finite"):
        InsertionPixelsEnv.check_arguments(light_shift=(0.0, float("nan"), 0.0))
