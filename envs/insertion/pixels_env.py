"""The batched insertion environment with a camera."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torchrl.data import Bounded

from .batched_env import InsertionEnv
from .camera import STILL, CameraConfig, TaskCamera, Vector, make_camera_config
from .config import InsertionConfig

PIXELS = "pixels"
"""The picture's entry."""


class InsertionPixelsEnv(InsertionEnv):
    """:class:`InsertionEnv` with a camera: one picture a control step.

    Writes beside the entries of :class:`InsertionEnv`:

    ============================  ==========================================================
    ``pixels``                    [picture_size, picture_size, 3] uint8, of this very state
    ============================  ==========================================================

    ``blocks`` remains for critics, which exist in simulation alone. A picture is a function of the
    physics state, so that it needs no state of its own.

    Args:
        variant: As for :class:`InsertionEnv`.
        num_envs: Batch size, 1 or more.
        num_threads: Threads for physics.
        seed: Seed of the first slot.
        camera: One of the scene's cameras: ``overview``, ``closeup``, ``front``, ``gap``.
        picture_size: Width and height [pixel].
        camera_shift: By how much the camera stands elsewhere than it should (x, y, z) [m].
        light_shift: By how much the lamp stands elsewhere (x, y, z) [m].
        overrides: Fields of :class:`~rrl.envs.InsertionConfig` to replace.

    Attributes:
        camera: Draws the pictures; its OpenGL context belongs to the thread that drew the first.

    Raises:
        ValueError: If a name is unknown, a number is out of range, or values do not fit together.
        RenderingUnavailable: At the first reset, if no OpenGL backend works.
    """

    def __init__(
        self,
        variant: str | InsertionConfig = "real",
        num_envs: int = 1,
        num_threads: int | None = None,
        seed: int | None = 0,
        camera: str = CameraConfig.camera,
        picture_size: int = CameraConfig.picture_size,
        camera_shift: Vector = STILL,
        light_shift: Vector = STILL,
        **overrides: Any,
    ) -> None:
        config = make_camera_config(
            camera=camera, picture_size=picture_size, camera_shift=camera_shift,
            light_shift=light_shift,
        )  # fmt: skip
        super().__init__(variant, num_envs, num_threads, seed, **overrides)
        simulation = self._simulation
        self.camera = TaskCamera(simulation.models[0], simulation.start, config)
        shape = (self.num_envs, picture_size, picture_size, 3)
        self._pixels = np.zeros(shape, dtype=np.uint8)
        self._shown = np.full((self.num_envs, simulation.state.shape[1] + 4), np.nan)
        observation = self.observation_spec.clone()
        observation[PIXELS] = Bounded(0, 255, shape=shape, dtype=torch.uint8)
        self.observation_spec = observation

    @staticmethod
    def check_arguments(
        variant: str | InsertionConfig = "real", *arguments: Any, **settings: Any
    ) -> dict[str, int]:
        """Check the constructor's arguments; see :meth:`InsertionEnv.check_arguments`."""
        names = [field.name for field in fields(CameraConfig) if field.name in settings]
        camera = make_camera_config(**{name: settings.pop(name) for name in names})
        sizes = InsertionEnv.check_arguments(variant, *arguments, **settings)
        return {**sizes, PIXELS: camera.picture_size**2 * 3}

    def _pack(self, diverged: np.ndarray, truncated: np.ndarray) -> TensorDict:
        entries = super()._pack(diverged, truncated)
        return entries.set(PIXELS, torch.from_numpy(self._pictures()))

    def _pictures(self) -> np.ndarray:
        """Return the slots' pictures [num_envs, size, size, 3]; draws those that have changed."""
        simulation = self._simulation
        parts = simulation.state, simulation.yaw, simulation.place
        shown = np.concatenate(parts, axis=1)
        for slot in np.flatnonzero((shown != self._shown).any(axis=1)).tolist():
            self._pixels[slot] = self.camera.draw(*(part[slot] for part in parts))
        self._shown = shown
        return self._pixels.copy()

    def close(self, **kwargs: Any) -> None:
        """End the physics threads, and give up the OpenGL context."""
        self.camera.close()
        super().close(**kwargs)
