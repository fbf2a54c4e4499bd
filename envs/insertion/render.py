"""Pictures of rollouts. OpenGL is not touched before the first one is made."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from dm_control import composer

from ..pictures import draw_data, draw_states, opened
from .model.arena import CAMERAS
from .physics.simulation import STATE

if TYPE_CHECKING:
    from .batched_env import InsertionEnv

HIDDEN = (4,)
"""The group of the collision plane."""


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
        camera: ``overview``, ``closeup``, ``front`` or ``gap``.
        width: Width [pixel].
        height: Height [pixel].

    Raises:
        RenderingUnavailable: If no OpenGL backend works.
        ValueError: If the camera is unknown, a size is below 1, or there are no states.
    """
    own = (np.asarray(state[slot] if np.ndim(state) > 1 else state) for state in states)
    return draw_states(env.slot_model(slot), own, STATE, camera, width, height, HIDDEN)


def render_composer(
    env: composer.Environment, camera: str = CAMERAS[0], width: int = 640, height: int = 480
) -> np.ndarray:
    """Return a picture [height, width, 3], uint8, of a composer environment as it stands."""
    with opened(env.physics.model.ptr, camera, width, height) as renderer:
        return draw_data(renderer, env.physics.data.ptr, camera, HIDDEN)
