"""Which encoder the inputs call for."""

from __future__ import annotations

from collections.abc import Sequence

from torch import nn

from rrl.encoders.concatenate import Concatenate
from rrl.encoders.interface import Inputs
from rrl.encoders.pixels import PixelEncoder, check_layers

__all__ = ["automatic"]


def automatic(
    inputs: Inputs,
    channels: Sequence[int] = (16, 32, 64),
    kernels: Sequence[int] = (5, 3, 3),
    strides: Sequence[int] = (4, 2, 2),
    features: int = 50,
    shift: int = 4,
) -> nn.Module:
    """Make a :class:`PixelEncoder` if an image is among the inputs, else :class:`Concatenate`.

    Args:
        inputs: Observation entries.
        channels: Of a camera's convolutions.
        kernels: Their sides, in pixels.
        strides: Their strides, in pixels.
        features: Of each camera.
        shift: Pixels by which a training image is moved, at most; 0: none.

    Raises:
        ValueError: If a number is out of range, or the inputs do not suit the encoder.
    """
    check_layers(channels, kernels, strides, features, shift)
    if any(entry.is_image for entry in inputs.values()):
        return PixelEncoder(inputs, channels, kernels, strides, features, shift)
    return Concatenate(inputs)
