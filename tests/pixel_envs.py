"""A small environment with a camera: where the goal is, only the picture shows."""

from __future__ import annotations

import torch
from torch import Tensor
from torchrl.data import Bounded

from toy_envs import PointMass, RememberingPointMass

SIDE = 16  # pixels of the picture
REACH = 1.0  # metres from the picture's middle to its border


class PixelPoint(PointMass):
    """A drifting point, and a picture of point (red) and goal (green) in ``pixels``.

    Args:
        channels: ``last``: ``[H, W, 3]``; ``first``: ``[3, H, W]``.
        cameras: More than one adds ``pixels_1``, ..., each darker than the one before.
        arguments: Of the point.
    """

    def __init__(self, *args, channels: str = "last", cameras: int = 1, **arguments) -> None:
        super().__init__(*args, **arguments)
        self._channels, self._cameras = channels, cameras
        shape = (SIDE, SIDE, 3) if channels == "last" else (3, SIDE, SIDE)
        for name in self._names():
            spec = Bounded(0, 255, (*self.batch_size, *shape), dtype=torch.uint8)
            self.observation_spec[name] = spec

    def _names(self) -> list[str]:
        return ["pixels", *(f"pixels_{i}" for i in range(1, self._cameras))]

    def _observe(self) -> dict[str, Tensor]:
        seen = super()._observe()
        image = torch.stack([dot(self._position), dot(self._goal), dot(self._goal * 0)], -1)
        if self._channels == "first":
            image = image.movedim(-1, -3).contiguous()
        return seen | {name: image // (i + 1) for i, name in enumerate(self._names())}


class RememberingPixelPoint(PixelPoint, RememberingPointMass):
    """One whose state can be saved."""


def dot(position: Tensor) -> Tensor:
    """Draw a soft dot at ``position`` [*batch, 2], ``[*batch, SIDE, SIDE]``."""
    axis = torch.linspace(-REACH, REACH, SIDE)
    x = (axis - position[..., 0:1]).unsqueeze(-2)  # columns
    y = (axis - position[..., 1:2]).unsqueeze(-1)  # rows
    return (255 * torch.exp(-(x.square() + y.square()) / 0.02)).to(torch.uint8)
