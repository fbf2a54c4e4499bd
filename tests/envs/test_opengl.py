"""OpenGL in processes of their own, because what is chosen there cannot be undone."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

TRAIN = "import rrl.envs as e; env = e.InsertionEnv('real'); env.rollout(2); print('stepped')"
RENDER = """
try:
    frames = e.render_states(env, [env.physics_state()], width=32, height=24)
    print("rendered", frames.std() > 1)
except e.RenderingUnavailable as error:
    print("unavailable", error)
"""
PIXELS = """
import mujoco, torch
from dm_control import manipulation
try:
    reset = e.ComposerEnv(manipulation.load("reach_site_vision"), seed=0).reset()
    images = [value for value in reset.values() if value.dtype == torch.uint8]
    print("pixels", max(image.float().std().item() for image in images) > 1)
    with mujoco.Renderer(env.slot_model(0), 24, 32) as renderer:
        renderer.update_scene(mujoco.MjData(env.slot_model(0)))
        print("mujoco", renderer.render().shape)
except e.RenderingUnavailable as error:
    print("no pixels", error)
"""


def run(code: str, **variables: str) -> str:
    """Run code in a process with only these environment variables; return what it printed."""
    environment = {"PATH": "/usr/bin:/bin", "HOME": "/tmp", "OMP_NUM_THREADS": "1", **variables}
    result = subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "-c", code],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return result.stdout


@pytest.mark.parametrize(
    "variables",
    [
        {},
        *(
            pytest.param(variables, marks=pytest.mark.slow)
            for variables in (
                {"MUJOCO_GL": "magic"},
                {"MUJOCO_GL": "osmesa"},
                {"MUJOCO_GL": "glfw"},
                {"PYOPENGL_PLATFORM": "osmesa"},
                {"MUJOCO_EGL_DEVICE_ID": "99"},
            )
        ),
    ],
    ids=lambda variables: ",".join(f"{k}={v}" for k, v in variables.items()) or "default",
)
def test_training_needs_no_opengl_and_rendering_says_what_it_lacks(variables: dict) -> None:
    output = run(TRAIN + RENDER, **variables)
    assert output.startswith("stepped\n")
    assert "rendered True" in output or ("unavailable" in output and "expected" in output)


def test_a_wrong_device_is_named() -> None:
    output = run(TRAIN + RENDER, MUJOCO_EGL_DEVICE_ID="none", MUJOCO_GL="egl")
    assert "unavailable MUJOCO_GL: expected a backend" in output
    assert "got 'egl' (egl: " in output and "apt-get install" in output


@pytest.mark.slow
def test_import_and_training_load_no_opengl_and_leave_the_environment_alone() -> None:
    check = """
import os, sys
print([name for name in sys.modules if name.split(".")[0] in ("OpenGL", "glfw")])
print(sorted(name for name in os.environ if name.startswith(("MUJOCO", "PYOPENGL"))))
"""
    assert run(TRAIN + check) == "stepped\n[]\n[]\n"
    assert run(TRAIN + check, MUJOCO_GL="osmesa") == "stepped\n[]\n['MUJOCO_GL']\n"


@pytest.mark.slow
def test_pixel_observables_and_mujocos_renderer_choose_a_backend_later() -> None:
    output = run(TRAIN + PIXELS)
    assert "no pixels" in output or output.endswith("pixels True\nmujoco (24, 32, 3)\n")


@pytest.mark.slow
def test_a_camera_touches_opengl_with_its_first_picture_and_ends_quietly() -> None:
    camera = """
import sys
import rrl.envs as e
env = e.InsertionPixelsEnv()
print([name for name in sys.modules if name.split(".")[0] in ("OpenGL", "glfw")])
try:
    print("seen", env.reset()["pixels"].float().std().item() > 20)
except e.RenderingUnavailable as error:
    print("unavailable", error)
"""
    for backend in ("egl", "osmesa", "glfw"):
        said = run(camera, MUJOCO_GL=backend)  # nothing on stderr, though nobody closed it
        assert said.startswith("[]\n")
        assert said.endswith("seen True\n") or "expected a backend that renders" in said


@pytest.mark.slow
def test_mujoco_that_is_imported_before_renders_too() -> None:
    output = run("import mujoco\n" + TRAIN + RENDER, PATH=os.environ["PATH"])
    assert "rendered True" in output or "unavailable" in output
