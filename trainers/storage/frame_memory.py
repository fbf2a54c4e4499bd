"""Frames in memory: bytes, each once."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

BLOCK = 1024
"""Frames of a piece of memory: what is taken at once, and given back."""


class FrameMemory:
    """Frames by number; memory is taken as they come, and given back from the oldest on.

    Args:
        device: Where they lie.

    Attributes:
        end: Number of the next frame.
    """

    def __init__(self, device: str = "cpu") -> None:
        self._device, self.end = device, 0
        self._blocks: dict[int, Tensor] = {}

    def start(self, first: int) -> None:
        """Begin anew with frame ``first``."""
        self.end = first
        self._blocks.clear()

    def append(self, frames: Tensor) -> None:
        """Add frames ``[n, C, H, W]`` behind the last one."""
        while len(frames):
            block, at = divmod(self.end, BLOCK)
            part, frames = frames[: BLOCK - at], frames[BLOCK - at :]
            if block not in self._blocks:
                shape = BLOCK, *part.shape[1:]
                self._blocks[block] = torch.empty(shape, dtype=part.dtype, device=self._device)
            self._blocks[block][at : at + len(part)] = part.to(self._device)
            self.end += len(part)

    def get(self, numbers: Sequence[int]) -> Tensor:
        """Return frames ``[n, C, H, W]`` by their numbers."""
        return torch.stack([self._blocks[n // BLOCK][n % BLOCK] for n in numbers])

    def forget(self, first: int) -> None:
        """Give back the memory of frames that lie before ``first``."""
        for block in [b for b in self._blocks if (b + 1) * BLOCK <= first]:
            del self._blocks[block]
