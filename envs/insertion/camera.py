"""What a camera sees of the insertion task: small pictures of physics states, drawn fast."""

from __future__ import annotations

import atexit
import copy
import weakref
from typing import Annotated

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, ValidationError
from pydantic.dataclasses import dataclass

from ..pictures import draw_data, opened
from .config import Number, explain
from .model.arena import CAMERAS
from .physics.simulation import STATE
from .physics.start import StartState
from .render import HIDDEN

LAMP = "key"
"""The light that is moved."""
Floats = NDArray[np.float64]
Vector = tuple[Number, Number, Number]
STILL = (0.0, 0.0, 0.0)


@dataclass(frozen=True, config=ConfigDict(allow_inf_nan=False))
class CameraConfig:
    """Which camera there is, how large its picture is, and what disturbs it."""

    camera: str = "gap"
    """One of the scene's cameras."""
    picture_size: Annotated[int, Field(strict=True, ge=8, le=512)] = 64
    """Width and height, pixel."""
    camera_shift: Vector = STILL
    """By how much the camera stands elsewhere than it should, in the world's frame, m."""
    light_shift: Vector = STILL
    """By how much the lamp stands elsewhere; it still shines at the same spot, m."""


def make_camera_config(**settings: object) -> CameraConfig:
    """Return the settings of a camera.

    Raises:
        ValueError: If a value is out of range, or the camera unknown.
    """
    try:
        config = CameraConfig(**settings)  # type: ignore[arg-type]
    except ValidationError as error:
        raise ValueError(explain(error)) from None
    if config.camera not in CAMERAS:
        raise ValueError(f"camera: expected one of {list(CAMERAS)}, got {config.camera!r}")
    return config


class TaskCamera:
    """Draws physics states of any slot; OpenGL is not touched before the first picture.

    Without a GPU shadows and reflections cost a hundred times what the rest does, and round shapes
    finer than a pixel half of it, so this camera has a model of its own that goes without. A
    picture depends on nothing but the state and where the standing blocks stood at the reset.

    Args:
        model: The task's model; it stays as it is.
        start: The start of its episodes, which writes yaws and places into models.
        config: The camera.
    """

    def __init__(self, model: mujoco.MjModel, start: StartState, config: CameraConfig) -> None:
        self.config = config
        self._start = start
        self._model = copy.copy(model)
        self._model.light_castshadow[:] = 0
        self._model.mat_reflectance[:] = 0
        self._model.vis.quality.numslices, self._model.vis.quality.numstacks = 8, 4
        self._model.vis.global_.offwidth = self._model.vis.global_.offheight = config.picture_size
        self._move_lamp()
        self._data = mujoco.MjData(self._model)
        self._camera = self._model.camera(config.camera).id
        self._renderer: mujoco.Renderer | None = None

    def draw(self, state: Floats, yaw: Floats, place: Floats) -> NDArray[np.uint8]:
        """Return the picture [size, size, 3] of a slot.

        Args:
            state: Its full physics state [nstate].
            yaw: Of the standing blocks at the reset [2].
            place: Of the standing blocks at the reset [2].

        Raises:
            RenderingUnavailable: If no OpenGL backend works.
        """
        model, data, size = self._model, self._data, self.config.picture_size
        if self._renderer is None:
            self._renderer = opened(model, self.config.camera, size, size)
            atexit.register(_close, weakref.ref(self))  # before OpenGL itself is taken down
        self._start.set_blocks(model, yaw, place)
        mujoco.mj_setState(model, data, state, STATE)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        data.cam_xpos[self._camera] += self.config.camera_shift
        return draw_data(self._renderer, data, self.config.camera, HIDDEN)

    def close(self) -> None:
        """Give up the OpenGL context."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _move_lamp(self) -> None:
        """Turn the lamp's parallel light to come from its shifted place, to where it shone."""
        lamp = self._model.light(LAMP)
        if self.config.light_shift != STILL:
            reach = lamp.pos[2] / -lamp.dir[2]  # along its ray, to the height of the platform
            ray = reach * lamp.dir - np.asarray(self.config.light_shift)
            lamp.dir[:] = ray / np.linalg.norm(ray)


def _close(camera: weakref.ref[TaskCamera]) -> None:
    if (found := camera()) is not None:
        found.close()
