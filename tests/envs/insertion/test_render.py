from __future__ import annotations

import numpy as np
import pytest
import torch

from insertion_helpers import act
from rrl.envs import (
    InsertionEnv,
    RenderingUnavailable,
    load,
    opengl,
    render_composer,
    render_states,
)


@pytest.fixture(scope="module")
def backend() -> str:
    try:
        return opengl.find_backend()
    except RenderingUnavailable as error:
        pytest.skip(str(error))


def test_frames_show_what_happens(backend: str) -> None:
    env = InsertionEnv("real", num_envs=2)
    env.reset()
    states = [env.physics_state()]
    for _ in range(4):
        act(env, torch.tensor([0.0, 0.0, -1.0]))
        states.append(env.physics_state())
    frames = render_states(env, states, slot=1, camera="closeup", width=160, height=120)
    assert frames.shape == (5, 120, 160, 3) and frames.dtype == np.uint8
    assert frames.std() > 20  # neither black nor blank
    assert np.abs(frames[0].astype(int) - frames[-1]).mean() > 1  # the arm moves
    one_slot = render_states(env, [s[1] for s in states], 1, "closeup", 160, 120)
    np.testing.assert_array_equal(frames, one_slot)


def test_yaw_is_in_the_picture(backend: str, variant: str) -> None:
    straight, turned = (
        render_states(env, [env.physics_state()], camera="closeup", width=160, height=120)
        for yaw in (0.0, 20.0)
        for env in [InsertionEnv(variant, yaw_choices=(yaw,), start_range=(0.0, 0.0, 0.0))]
        if env.reset() is not None
    )
    assert (straight != turned).any()


def test_composer(backend: str) -> None:
    env = load("insertion-sim", random_state=0)
    env.reset()
    assert render_composer(env, width=160, height=120).std() > 20


def test_bad_input(backend: str) -> None:
    env = InsertionEnv("sim")
    env.reset()
    with pytest.raises(ValueError, match=r"camera: expected .*'overview'.*got 'top'"):
        render_states(env, [env.physics_state()], camera="top", width=32, height=32)
    with pytest.raises(ValueError, match="states: expected at least one"):
        render_states(env, [], width=32, height=32)
    with pytest.raises(ValueError, match="expected at least 1, got 0 x 480"):
        render_states(env, [env.physics_state()], width=0)
