"""Pictures of any MuJoCo environment: its states are kept while it runs, and drawn later.

OpenGL is not touched before the first picture is made.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from .opengl import find_backend

STATE = mujoco.mjtState.mjSTATE_INTEGRATION.value
"""All that a picture may depend on, bodies moved from outside (mocap) included."""


def mujoco_state(env: Any) -> NDArray[np.float64]:
    """Return the state of an environment's physics, for :func:`render_mujoco`.

    Args:
        env: A Gymnasium or dm_control environment, or TorchRL's wrapper of one.

    Raises:
        TypeError: If it has no MuJoCo model.
    """
    model, data = _physics(env)
    state = np.zeros(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def render_mujoco(
    env: Any,
    states: Iterable[NDArray[np.float64]],
    camera: str | None = None,
    width: int = 640,
    height: int = 480,
) -> NDArray[np.uint8]:
    """Return frames ``[T, height, width, 3]`` of states that :func:`mujoco_state` gave.

    Args:
        env: The environment that made the states, not reset since: goals may be part of its model.
        states: The states ``[T]``.
        camera: Name of a camera of the model; None: one that sees all of it.
        width: Width [pixel].
        height: Height [pixel].

    Raises:
        RenderingUnavailable: If no OpenGL backend works.
        TypeError: If it has no MuJoCo model.
        ValueError: If the camera is unknown, a size is below 1, or there are no states.
    """
    model, _ = _physics(env)
    return draw_states(model, states, STATE, camera, width, height)


def draw_states(
    model: mujoco.MjModel,
    states: Iterable[NDArray[np.float64]],
    kind: int,
    camera: str | None,
    width: int,
    height: int,
    hidden: Sequence[int] = (),
) -> NDArray[np.uint8]:
    """Draw states of a model; ``kind`` is what they hold, ``hidden`` are groups of geoms.

    Raises:
        ValueError: If there are no states.
    """
    data, frames = mujoco.MjData(model), []
    with opened(model, camera, width, height) as renderer:
        for state in states:
            mujoco.mj_setState(model, data, np.asarray(state, dtype=np.float64), kind)
            mujoco.mj_forward(model, data)
            frames.append(draw_data(renderer, data, camera, hidden))
    if not frames:
        raise ValueError("states: expected at least one, got none")
    return np.stack(frames)


def opened(model: mujoco.MjModel, camera: str | None, width: int, height: int) -> mujoco.Renderer:
    """Return a renderer for pictures of this size, to be used in a ``with`` statement.

    Raises:
        ValueError: If there is no such camera, or a side is below 1.
    """
    if width < 1 or height < 1:
        raise ValueError(f"width and height: expected at least 1, got {width} x {height}")
    names = [model.camera(index).name for index in range(model.ncam)]
    if camera is not None and camera not in names:
        raise ValueError(f"camera: expected one of {names}, got {camera!r}")
    find_backend()
    model.vis.global_.offwidth = max(width, model.vis.global_.offwidth)
    model.vis.global_.offheight = max(height, model.vis.global_.offheight)
    return mujoco.Renderer(model, height, width)


def draw_data(
    renderer: mujoco.Renderer, data: mujoco.MjData, camera: str | None, hidden: Sequence[int] = ()
) -> NDArray[np.uint8]:
    """Return a picture ``[height, width, 3]`` of data as they stand."""
    option = mujoco.MjvOption()
    option.geomgroup[list(hidden)] = 0
    renderer.update_scene(data, -1 if camera is None else camera, option)
    return renderer.render()


def _physics(env: Any) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Find the model and its data, where Gymnasium, dm_control or robosuite keep them."""
    if (physics := getattr(env, "physics", None)) is not None:  # TorchRL's wrappers have it too
        return physics.model.ptr, physics.data.ptr
    inner = getattr(env, "unwrapped", env)
    owner = getattr(inner, "sim", inner)
    model, data = getattr(owner, "model", None), getattr(owner, "data", None)
    model, data = getattr(model, "_model", model), getattr(data, "_data", data)
    if not isinstance(model, mujoco.MjModel):
        raise TypeError(
            f"env: expected an environment with a MuJoCo model, got a {type(inner).__name__}"
        )
    return model, data
