"""Random shifts, the augmentation that learning from images depends on."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["random_shift"]


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
