"""Pictures of rollouts. OpenGL is not touched before the first one is made."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from dm_control import composer

from ..opengl import find_backend
from .model.arena import CAMERAS
from .physics.simulation import STATE

if TYPE_CHECKING:
    from .batched_env import InsertionEnv

__all__ = ["render_composer", "render_states"]


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
        ValueError: If the camera is unknown, a size is below 1, or there are no states.
    """
    model = env.slot_model(slot)
    data = mujoco.MjData(model)
    frames = []
    with _renderer(model, camera, width, height) as renderer:
        for state in states:
            own = np.asarray(state[slot] if np.ndim(state) > 1 else state, dtype=np.float64)
            mujoco.mj_setState(model, data, own, STATE)
            mujoco.mj_forward(model, data)
            frames.append(_picture(renderer, data, camera))
    if not frames:
        raise ValueError("states: expected at least one, got none")
    return np.stack(frames)


def render_composer(
    env: composer.Environment, camera: str = CAMERAS[0], width: int = 640, height: int = 480
) -> np.ndarray:
    """Return a picture [height, width, 3], uint8, of a composer environment as it stands."""
    with _renderer(env.physics.model.ptr, camera, width, height) as renderer:
        return _picture(renderer, env.physics.data.ptr, camera)


def _renderer(model: mujoco.MjModel, camera: str, width: int, height: int) -> mujoco.Renderer:
    if width < 1 or height < 1:
        raise ValueError(f"width and height: expected at least 1, got {width} x {height}")
    names = [model.camera(index).name for index in range(model.ncam)]
    if camera not in names:
        raise ValueError(f"camera: expected one of {names}, got {camera!r}")
    find_backend()
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    return mujoco.Renderer(model, height, width)


def _picture(renderer: mujoco.Renderer, data: mujoco.MjData, camera: str) -> np.ndarray:
    option = mujoco.MjvOption()
    option.geomgroup[4] = 0  # the collision plane
    renderer.update_scene(data, camera, option)
    return renderer.render()
