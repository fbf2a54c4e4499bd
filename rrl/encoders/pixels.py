"""The encoder of images that is learned, small enough for a processor core, and the default."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from rrl.checks import check_sizes
from rrl.encoders.concatenate import Concatenate
from rrl.encoders.images import ImagesBesideNumbers, as_channels_first
from rrl.encoders.interface import Inputs
from rrl.inputs import Input


class PixelEncoder(ImagesBesideNumbers):
    """A convolutional network for each camera, learned with the critics; numbers stand beside.

    Convolutions with ReLU units, then one linear layer, normalized and bounded by tanh, as in
    DrQ-v2 (Yarats et al., 2021). In training every image of a batch is shifted by a few pixels,
    drawn anew for each observation and for the one after it.

    Args:
        inputs: Observation entries; at least one is an image.
        channels: Of the convolutions.
        kernels: Their sides, in pixels.
        strides: Their strides, in pixels.
        features: Of each camera.
        shift: Pixels by which a training image is moved, at most; 0: none.

    Raises:
        ValueError: If there is no image, one has a center or a scale, or a number is out of range.
    """

    def __init__(
        self,
        inputs: Inputs,
        channels: Sequence[int] = (16, 32, 64),
        kernels: Sequence[int] = (5, 3, 3),
        strides: Sequence[int] = (4, 2, 2),
        features: int = 50,
        shift: int = 4,
    ) -> None:
        super().__init__(inputs)
        _check_layers(channels, kernels, strides, features, shift)
        self.features, self.shift = features, shift
        layers = list(zip(channels, kernels, strides, strict=True))
        self.cameras = nn.ModuleList(
            _camera(entry, layers, features) for entry in self.images.values()
        )

    def see(self, camera: int, images: Tensor) -> Tensor:
        """Return features in [-1, 1]."""
        return self.cameras[camera](images - 0.5)

    def augment(self, *values: Tensor) -> list[Tensor]:
        """Return values ``[B, *shape]`` with each image shifted at random."""
        return [
            self._moved(value, entry) if entry.is_image else value
            for entry, value in zip(self._inputs.values(), values, strict=True)
        ]

    def _moved(self, value: Tensor, entry: Input) -> Tensor:
        moved = random_shift(as_channels_first(value, entry), self.shift)
        if entry.channels == "last":
            *frames, height, width, channels = entry.shape
            return moved.reshape(-1, *frames, channels, height, width).movedim(-3, -1)
        return moved.reshape(value.shape)


def random_shift(images: Tensor, most: int) -> Tensor:
    """Move each image by up to ``most`` pixels, along both axes; its border fills the gap.

    Kostrikov et al., *Image augmentation is all you need*, 2021. The shifts are drawn from torch's
    global generator on the CPU, wherever the images lie.

    Args:
        images: ``[B, C, H, W]`` of any dtype.
        most: Pixels, at least 0.
    """
    if most == 0:
        return images
    batch, channels, height, width = images.shape
    shift = (torch.rand(2, batch, 1) * (2 * most + 1)).long() - most
    rows = (torch.arange(height) + shift[0]).clamp(0, height - 1)  # (B, H)
    columns = (torch.arange(width) + shift[1]).clamp(0, width - 1)  # (B, W)
    source = (rows.unsqueeze(2) * width + columns.unsqueeze(1)).flatten(1).unsqueeze(1)
    source = source.expand(batch, channels, height * width).to(images.device)
    return images.flatten(2).gather(2, source).reshape(images.shape)


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
    _check_layers(channels, kernels, strides, features, shift)
    if any(entry.is_image for entry in inputs.values()):
        return PixelEncoder(inputs, channels, kernels, strides, features, shift)
    return Concatenate(inputs)


def _camera(entry: Input, layers: list[tuple[int, int, int]], features: int) -> nn.Module:
    example = as_channels_first(torch.zeros(entry.shape), entry)  # (1, C, H, W)
    modules, before = list[nn.Module](), example.shape[1]
    for after, kernel, stride in layers:
        modules += [nn.Conv2d(before, after, kernel, stride, kernel // 2), nn.ReLU()]
        before = after
    convolutions = nn.Sequential(*modules, nn.Flatten())
    size = convolutions(example).shape[1]
    return nn.Sequential(convolutions, nn.Linear(size, features), nn.LayerNorm(features), nn.Tanh())


def _check_layers(
    channels: Sequence[int],
    kernels: Sequence[int],
    strides: Sequence[int],
    features: int,
    shift: int,
) -> None:
    """Refuse numbers of :class:`PixelEncoder` that are out of range.

    Raises:
        ValueError: Naming the argument, what was expected and what came.
    """
    for name, numbers in (("channels", channels), ("kernels", kernels), ("strides", strides)):
        check_sizes(name, numbers)
    if not len(channels) == len(kernels) == len(strides) > 0:
        raise ValueError(
            "channels, kernels, strides: expected lists of the same length, one number a layer, "
            f"got {len(channels)}, {len(kernels)} and {len(strides)}"
        )
    for name, number, least in (("features", features, 1), ("shift", shift, 0)):
        if not isinstance(number, int) or number < least:
            raise ValueError(f"{name}: expected a whole number of at least {least}, got {number!r}")
