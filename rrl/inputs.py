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

    An entry with neither is standardized by what the first episodes show.

    Args:
        loc: Center, one number or one for each of the entry's numbers; None: 0.
        scale: Factor, one number or one for each of the entry's numbers; None: 1.
        shape: Shape of the entry without batch dimensions; filled in from the environment.
    """

    loc: float | Sequence[float] | None = None
    scale: float | Sequence[float] | None = None
    shape: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """How many numbers the entry has."""
        return math.prod(self.shape)

    @property
    def is_derived(self) -> bool:
        """Whether center and scale are to be derived."""
        return self.loc is None and self.scale is None

    def column(self, field: str) -> Tensor:
        """Return ``loc`` or ``scale`` as a float32 vector ``[size]``.

        Raises:
            ValueError: If it is a list of another length, or not finite.
        """
        given = getattr(self, field)
        if given is None:
            given = 0.0 if field == "loc" else 1.0
        try:
            value = torch.as_tensor(given, dtype=torch.float32).reshape(-1)
        except (TypeError, ValueError, RuntimeError):
            raise ValueError(f"{field}: expected numbers, got {getattr(self, field)!r}") from None
        if value.numel() not in (1, self.size):
            raise ValueError(f"{field}: expected 1 or {self.size} numbers, got {value.numel()}")
        if not value.isfinite().all():
            raise ValueError(f"{field}: expected finite numbers, got {getattr(self, field)!r}")
        return value.expand(self.size)
