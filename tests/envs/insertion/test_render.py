from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
import torch
from imageio_ffmpeg import count_frames_and_secs
from insertion_helpers import act

from rrl.envs import (
    InsertionEnv,
    RenderingUnavailable,
    load,
    render_composer,
    render_states,
    write_video,
)
from rrl.envs.insertion import render as render_module


@pytest.fixture(scope="module")
def backend() -> str:
    try:
        return render_module.find_backend()
    except RenderingUnavailable as error:
        pytest.skip(str(error))


def test_frames_show_what_happens(backend: str, tmp_path: Path) -> None:
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
    gif = write_video(tmp_path / "new" / "video.gif", frames)
    assert iio.imread(gif).shape == frames.shape
    mp4 = write_video(tmp_path / "new" / "video.mp4", frames)
    assert count_frames_and_secs(mp4)[0] == 5


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


def test_bad_input(backend: str, tmp_path: Path) -> None:
    env = InsertionEnv("sim")
    env.reset()
    with pytest.raises(ValueError, match=r"unknown camera 'top'.*overview"):
        render_states(env, [env.physics_state()], camera="top", width=32, height=32)
    with pytest.raises(ValueError, match="no states"):
        render_states(env, [], width=32, height=32)
    with pytest.raises(ValueError, match="must be at least 1"):
        render_states(env, [env.physics_state()], width=0)
    with pytest.raises(ValueError, match=r"\.mp4 or \.gif"):
        write_video(tmp_path / "video.avi", np.zeros((1, 8, 8, 3), np.uint8))
    with pytest.raises(ValueError, match="no frames"):
        write_video(tmp_path / "video.gif", np.zeros((0, 8, 8, 3), np.uint8))


def test_without_any_backend_there_is_a_clear_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(render_module, "_PROBE", "raise ImportError('no driver')")
    render_module.find_backend.cache_clear()
    env = InsertionEnv("sim")
    env.reset()
    with pytest.raises(RenderingUnavailable, match=r"egl: ImportError: no driver.*apt-get install"):
        render_states(env, [env.physics_state()])
    render_module.find_backend.cache_clear()


def test_import_is_quiet_without_a_display() -> None:
    """A machine without a display prints nothing and warns of nothing."""
    environment = {"PATH": "/usr/bin:/bin", "HOME": "/tmp"}
    result = subprocess.run(
        [sys.executable, "-c", "import rrl.envs; rrl.envs.InsertionEnv().rollout(2)"],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert result.stderr == "" and result.stdout == ""
