"""Pictures of rollouts. OpenGL is not touched before the first :class:`Renderer` is made."""

from __future__ import annotations

from collections.abc import Iterable
from types import TracebackType
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from dm_control import composer

from ..opengl import make_context
from .model.arena import CAMERAS
from .physics.simulation import STATE

if TYPE_CHECKING:
    from .batched_env import InsertionEnv

__all__ = ["Renderer", "render_composer", "render_states"]


class Renderer:
    """A renderer of MuJoCo states off screen; a context manager.

    Args:
        model: What to render; every later frame must be of a model of the same shape.
        width: Width [pixel].
        height: Height [pixel].

    Raises:
        RenderingUnavailable: If no OpenGL backend works.
        ValueError: If a size is below 1.
    """

    def __init__(self, model: mujoco.MjModel, width: int = 640, height: int = 480) -> None:
        if width < 1 or height < 1:
            raise ValueError(f"width and height: expected at least 1, got {width} x {height}")
        model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
        model.vis.global_.offheight = max(height, model.vis.global_.offheight)
        self._size = (height, width)
        self._gl = make_context(width, height)
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
        """Return one picture [height, width, 3], uint8.

        Raises:
            ValueError: If the camera is unknown; the message lists the choices.
        """
        names = [model.camera(index).name for index in range(model.ncam)]
        if camera not in names:
            raise ValueError(f"camera: expected one of {names}, got {camera!r}")
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
        """Return one picture [height, width, 3] of a full physics state [nstate]."""
        mujoco.mj_setState(model, self._data, np.asarray(state, dtype=np.float64), STATE)
        mujoco.mj_forward(model, self._data)
        return self.frame(model, self._data, camera)

    def close(self) -> None:
        """Free the OpenGL context."""
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
    """Return frames [T, height, width, 3], uint8, of one slot of the batched environment.

    In ``sim`` the standing blocks' yaw is part of the slot's model, so render an episode before the
    slot is reset.

    Args:
        env: The environment that made the states.
        states: What ``env.physics_state()`` gave after each step, [T, num_envs, nstate], or the
            slot's alone, [T, nstate].
        slot: Which environment of the batch.
        camera: ``overview``, ``closeup`` or ``front``.
        width: Width [pixel].
        height: Height [pixel].

    Raises:
        RenderingUnavailable: If no OpenGL backend works.
        ValueError: If the camera is unknown, or there are no states.
    """
    model = env.slot_model(slot)
    with Renderer(model, width, height) as renderer:
        frames = [
            renderer.state_frame(model, state[slot] if np.ndim(state) > 1 else state, camera)
            for state in states
        ]
    if not frames:
        raise ValueError("states: expected at least one, got none")
    return np.stack(frames)


def render_composer(
    env: composer.Environment, camera: str = CAMERAS[0], width: int = 640, height: int = 480
) -> np.ndarray:
    """Return a picture [height, width, 3], uint8, of a composer environment as it stands.

    Raises:
        RenderingUnavailable: If no OpenGL backend works.
        ValueError: If the camera is unknown.
    """
    model, data = env.physics.model.ptr, env.physics.data.ptr
    with Renderer(model, width, height) as renderer:
        return renderer.frame(model, data, camera)
