"""What a policy reads: observation entries, their shapes and how they are normalized."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["Input"]


@dataclass(frozen=True)
class Input:
    """One observation entry, normalized as ``(value - loc) * scale``.

    Args:
        loc: Center, one number or one for each of the entry's numbers.
        scale: Factor, one number or one for each of the entry's numbers.
        shape: Shape of the entry without batch dimensions; filled in from the environment.
    """

    loc: float | Sequence[float] = 0.0
    scale: float | Sequence[float] = 1.0
    shape: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """How many numbers the entry has."""
        return math.prod(self.shape)

    def column(self, field: str) -> Tensor:
        """Return ``loc`` or ``scale`` as a float32 vector ``[size]``.

        Raises:
            ValueError: If it is a list of another length, or not finite.
        """
        try:
            value = torch.as_tensor(getattr(self, field), dtype=torch.float32).reshape(-1)
        except (TypeError, ValueError, RuntimeError):
            raise ValueError(f"{field}: expected numbers, got {getattr(self, field)!r}") from None
        if value.numel() not in (1, self.size):
            raise ValueError(f"{field}: expected 1 or {self.size} numbers, got {value.numel()}")
        if not value.isfinite().all():
            raise ValueError(f"{field}: expected finite numbers, got {getattr(self, field)!r}")
        return value.expand(self.size)
