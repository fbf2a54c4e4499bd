"""A network that was trained elsewhere, as the encoder of images."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, nn

from rrl.encoders.images import ImagesBesideNumbers, as_channels_first
from rrl.encoders.interface import Inputs


class FrozenEncoder(ImagesBesideNumbers):
    """A pretrained network for the images of all cameras, which nothing here changes.

    Its features are normalized to mean 0 and standard deviation 1 over those of one image. They are
    computed once a training batch, because they never change, and images are not shifted.

    Args:
        inputs: Observation entries; at least one is an image.
        network: Makes the network: from images ``[B, C, H, W]`` in [0, 1] to features of any shape
            ``[B, ...]``.

    Raises:
        ValueError: If there is no image, one has a center or a scale, the network gives no features
            ``[B, ...]``, or cameras give different numbers of them.
    """

    def __init__(self, inputs: Inputs, network: Callable[[], nn.Module]) -> None:
        super().__init__(inputs)
        self.network = network().requires_grad_(False).eval()
        sizes = set()
        for entry in self.images.values():
            with torch.no_grad():
                out = self.network(as_channels_first(torch.zeros(2, *entry.shape), entry))
            if not isinstance(out, Tensor) or out.ndim < 2 or len(out) != 2:
                got = tuple(out.shape) if isinstance(out, Tensor) else type(out).__name__
                raise ValueError(f"network: expected features [B, ...] of 2 images, got {got}")
            sizes.add(out[0].numel())
        if len(sizes) > 1:
            raise ValueError(
                "network: expected as many features of every camera, got "
                f"{', '.join(map(str, sorted(sizes)))}; make the images of one size"
            )
        self.features = sizes.pop()

    def see(self, camera: int, images: Tensor) -> Tensor:
        """Return the network's features, normalized."""
        return nn.functional.layer_norm(self.network(images).flatten(1), [self.features])

    def train(self, mode: bool = True) -> FrozenEncoder:
        """Stay in evaluation mode: a pretrained network's statistics do not move."""
        super().train(mode)
        self.network.eval()
        return self
