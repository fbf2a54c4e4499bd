"""Pictures of rollouts, with EGL or OSMesa, whichever the machine has.

Nothing here touches OpenGL before the first :class:`Renderer` is made.
"""

from __future__ import annotations

import functools
import importlib
import os
import subprocess
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import imageio
import mujoco
import numpy as np
from dm_control import composer

from .model.arena import CAMERAS
from .physics.simulation import STATE

if TYPE_CHECKING:
    from .batched_env import InsertionEnv

BACKENDS = ("egl", "osmesa")
_PROBE = """
import sys, importlib
context = importlib.import_module("mujoco." + sys.argv[1]).GLContext(16, 16)
context.make_current()
import mujoco
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), 150)
print("works", flush=True)
import os
os._exit(0)
"""


class RenderingUnavailable(RuntimeError):
    """Neither EGL nor OSMesa works on this machine."""


@functools.cache
def find_backend() -> str:
    """The first backend that can make a context: ``egl`` or ``osmesa``.

    Tried in a process of its own, because a broken driver may end the process. The environment
    variable ``MUJOCO_GL`` restricts the choice where it names one of the two.

    Raises:
        RenderingUnavailable: neither works; the message says what to install.
    """
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    reasons = []
    for backend in (wanted,) if wanted in BACKENDS else BACKENDS:
        environment = {**os.environ, "PYOPENGL_PLATFORM": backend, "MUJOCO_GL": backend}
        try:
            probe = subprocess.run(
                [sys.executable, "-c", _PROBE, backend],
                env=environment, capture_output=True, text=True, timeout=60, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            reasons.append(f"{backend}: no answer within 60 s")
            continue
        if "works" in probe.stdout:
            return backend
        lines = probe.stderr.strip().splitlines() or ["no message"]
        reasons.append(f"{backend}: {lines[-1]}")
    raise RenderingUnavailable(
        "cannot render on this machine (training and evaluation do not need to): "
        + "; ".join(reasons)
        + ". Install one of them, on Debian or Ubuntu for instance `apt-get install libegl1 "
        "libgl1-mesa-dri` for EGL or `apt-get install libosmesa6` for OSMesa."
    )


def _make_context(width: int, height: int) -> Any:
    backend = find_backend()
    platform = os.environ.setdefault("PYOPENGL_PLATFORM", backend)
    if platform != backend:
        raise RenderingUnavailable(
            f"PYOPENGL_PLATFORM is {platform!r} in this process but {backend!r} is what works here; "
            f"start again with PYOPENGL_PLATFORM={backend}"
        )
    context = importlib.import_module(f"mujoco.{backend}").GLContext(width, height)
    context.make_current()
    return context


class Renderer:
    """Renders MuJoCo states off screen; a context manager.

    Args:
        model: what to render; every later frame must be of a model of the same shape.
        width: pixels.
        height: pixels.

    Raises:
        RenderingUnavailable: see :func:`find_backend`.
        ValueError: a size below 1.
    """

    def __init__(self, model: mujoco.MjModel, width: int = 640, height: int = 480) -> None:
        if width < 1 or height < 1:
            raise ValueError(f"width and height must be at least 1, got {width} x {height}")
        model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
        model.vis.global_.offheight = max(height, model.vis.global_.offheight)
        self._size = (height, width)
        self._gl = _make_context(width, height)
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[4] = 0  # the collision plane
        self._camera = mujoco.MjvCamera()
        self._data = mujoco.MjData(model)

    def frame(
        self, model: mujoco.MjModel, data: mujoco.MjData, camera: str = CAMERAS[0]
    ) -> np.ndarray:
        """One picture [height, width, 3], uint8.

        Raises:
            ValueError: unknown camera; the message lists the choices.
        """
        names = [model.camera(index).name for index in range(model.ncam)]
        if camera not in names:
            raise ValueError(f"unknown camera {camera!r}; choose one of {names}")
        self._gl.make_current()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED.value
        self._camera.fixedcamid = names.index(camera)
        mujoco.mjv_updateScene(
            model, data, self._option, None, self._camera,
            mujoco.mjtCatBit.mjCAT_ALL.value, self._scene,
        )  # fmt: skip
        height, width = self._size
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._scene, self._context)
        pixels = np.empty((height, width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, viewport, self._context)
        return np.flipud(pixels)

    def state_frame(
        self, model: mujoco.MjModel, state: np.ndarray, camera: str = CAMERAS[0]
    ) -> np.ndarray:
        """One picture [height, width, 3] of a full physics state [nstate]."""
        mujoco.mj_setState(model, self._data, np.asarray(state, dtype=np.float64), STATE)
        mujoco.mj_forward(model, self._data)
        return self.frame(model, self._data, camera)

    def close(self) -> None:
        """Frees the OpenGL context."""
        if self._gl is not None:
            self._context.free()
            self._gl.free()
            self._gl = None

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def render_states(
    env: InsertionEnv,
    states: Iterable[np.ndarray],
    slot: int = 0,
    camera: str = CAMERAS[0],
    width: int = 640,
    height: int = 480,
) -> np.ndarray:
    """Frames [T, height, width, 3], uint8, of one slot of the batched environment.

    In ``sim`` the standing blocks' yaw is part of the slot's model, so render an episode before the
    slot is reset.

    Args:
        env: the environment that made the states.
        states: what ``env.physics_state()`` gave after each step: [T, num_envs, nstate], or the slot's
            alone, [T, nstate].
        slot: which environment of the batch.
        camera: ``overview``, ``closeup`` or ``front``.
        width: pixels.
        height: pixels.

    Raises:
        RenderingUnavailable: see :func:`find_backend`.
        ValueError: unknown camera, or no states.
    """
    model = env.slot_model(slot)
    with Renderer(model, width, height) as renderer:
        frames = [
            renderer.state_frame(model, state[slot] if np.ndim(state) > 1 else state, camera)
            for state in states
        ]
    if not frames:
        raise ValueError("there are no states to render")
    return np.stack(frames)


def render_composer(
    env: composer.Environment, camera: str = CAMERAS[0], width: int = 640, height: int = 480
) -> np.ndarray:
    """A picture [height, width, 3], uint8, of a composer environment as it stands.

    Raises:
        RenderingUnavailable: see :func:`find_backend`.
        ValueError: unknown camera.
    """
    model, data = env.physics.model.ptr, env.physics.data.ptr
    with Renderer(model, width, height) as renderer:
        return renderer.frame(model, data, camera)


def write_video(
    path: str | Path, frames: np.ndarray | Sequence[np.ndarray], fps: float = 20.0
) -> Path:
    """Writes frames [T, height, width, 3], uint8, as ``.mp4`` or ``.gif``; makes the folder.

    Raises:
        ValueError: another ending, or no frames.
    """
    path = Path(path)
    if path.suffix not in (".mp4", ".gif"):
        raise ValueError(f"a video must end in .mp4 or .gif, got {path.name!r}")
    if len(frames) == 0:
        raise ValueError("there are no frames to write")
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".gif":
        imageio.mimwrite(path, list(frames), duration=1000 / fps, loop=0)
    else:
        imageio.mimwrite(path, list(frames), fps=fps, macro_block_size=2, quality=8)
    return path
