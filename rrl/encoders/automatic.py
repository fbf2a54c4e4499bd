"""Which encoder the inputs call for."""

from __future__ import annotations

from typing import Any

from torch import nn

from rrl.encoders.concatenate import Concatenate
from rrl.encoders.interface import Inputs
from rrl.encoders.pixels import PixelEncoder

__all__ = ["automatic"]


def automatic(inputs: Inputs, **images: Any) -> nn.Module:
    """Make a :class:`PixelEncoder` if an image is among the inputs, else :class:`Concatenate`.

    Args:
        inputs: Observation entries.
        images: What the pixel encoder takes.
    """
    if any(entry.is_image for entry in inputs.values()):
        return PixelEncoder(inputs, **images)
    return Concatenate(inputs)
