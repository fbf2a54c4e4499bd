"""What encoders of images share: the images of a batch, and the numbers beside them."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any

import torch
from tensordict import NestedKey
from torch import Tensor, nn

from rrl.encoders.concatenate import Concatenate
from rrl.encoders.interface import Inputs
from rrl.inputs import Input


class ImagesBesideNumbers(nn.Module):
    """Features of each image, one after the other, and after them the normalized numbers.

    A subclass says what the features of one camera's images are (:meth:`see`) and sets
    :attr:`features`, their number for each camera.

    Args:
        inputs: Observation entries; at least one is an image.

    Raises:
        ValueError: If there is no image, or one has a center or a scale.
    """

    features: int

    def __init__(self, inputs: Inputs) -> None:
        super().__init__()
        self.images = {key: entry for key, entry in inputs.items() if entry.is_image}
        if not self.images:
            raise ValueError(
                "encoder: expected an image among the inputs (uint8 [..., H, W, C] or "
                f"[..., C, H, W]), got {', '.join(map(str, inputs))}; set channels: first or last "
                "of an input that is one"
            )
        for key, entry in self.images.items():
            if not entry.is_derived:
                raise ValueError(
                    f"inputs.{key}: expected neither loc nor scale, because images are divided by "
                    "255; set channels: none to have it read as numbers"
                )
        numbers = {key: entry for key, entry in inputs.items() if not entry.is_image}
        self.numbers = Concatenate(numbers) if numbers else None
        self._inputs = dict(inputs)
        self._seen = [i for i, key in enumerate(inputs) if key in self.images]
        self._beside = [i for i, key in enumerate(inputs) if key in numbers]
        self.calibrated_by: list[NestedKey] = list(numbers)
        """The entries that :meth:`calibrate` takes: the numbers."""

    @abstractmethod
    def see(self, camera: int, images: Tensor) -> Tensor:
        """Return features ``[B, features]`` of a camera's images ``[B, C, H, W]`` in [0, 1]."""

    @property
    def out_features(self) -> int:
        """Features of all entries."""
        beside = 0 if self.numbers is None else self.numbers.out_features
        return len(self.images) * self.features + beside

    def calibrate(self, *numbers: Tensor) -> dict[NestedKey, Any]:
        """Standardize the numbers ``[n, *shape]``; see :meth:`Concatenate.calibrate`."""
        return {} if self.numbers is None else self.numbers.calibrate(*numbers)

    def forward(self, *values: Tensor) -> Tensor:
        """Return features ``[*batch, n]`` of entries ``[*batch, *shape]``."""
        seen = []
        for camera, (i, entry) in enumerate(zip(self._seen, self.images.values(), strict=True)):
            batch = values[i].shape[: values[i].ndim - len(entry.shape)]
            images = as_channels_first(values[i], entry)
            images = images.float() / 255.0 if images.dtype == torch.uint8 else images.float()
            seen.append(self.see(camera, images).reshape(*batch, self.features))
        if self.numbers is not None:
            seen.append(self.numbers(*(values[i] for i in self._beside)))
        return torch.cat(seen, -1)


def as_channels_first(value: Tensor, entry: Input) -> Tensor:
    """Return an entry's images ``[*batch, *shape]`` as ``[B, C, H, W]``; frames are channels."""
    images = value.reshape(-1, *entry.shape)
    if entry.channels == "last":
        images = images.movedim(-1, -3)
    return images.reshape(len(images), math.prod(images.shape[1:-2]), *images.shape[-2:])
