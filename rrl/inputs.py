"""What a policy reads: observation entries, their shapes and how they are normalized."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor

Channels = Literal["first", "last", "none"]
"""Where an image has its channels; ``none``: the entry is no image, but numbers."""


@dataclass(frozen=True)
class Input:
    """One observation entry; numbers are normalized as ``(value - loc) * scale``.

    An entry with neither is standardized by what the first episodes show. An image has no center
    and scale of its own.

    Args:
        loc: Center, one number or one for each of the entry's numbers; None: 0.
        scale: Factor, one number or one for each of the entry's numbers; None: 1.
        shape: Shape of the entry without batch dimensions; filled in from the environment.
        channels: Where an image has its channels, ``first`` or ``last``, or ``none`` for numbers;
            None: filled in from the environment by :func:`channels_of`.

    Raises:
        ValueError: If ``channels`` is something else.
    """

    loc: float | Sequence[float] | None = None
    scale: float | Sequence[float] | None = None
    shape: tuple[int, ...] = ()
    channels: Channels | None = None

    def __post_init__(self) -> None:
        if self.channels not in (None, *get_args(Channels)):
            choices = ", ".join(get_args(Channels))
            raise ValueError(f"channels: expected one of {choices}, got {self.channels!r}")

    @property
    def size(self) -> int:
        """How many numbers the entry has."""
        return math.prod(self.shape)

    @property
    def is_image(self) -> bool:
        """Whether the entry is read as an image."""
        return self.channels in ("first", "last")

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


def channels_of(shape: Sequence[int], dtype: torch.dtype) -> Channels:
    """Return where an entry has its channels, if it is an image by its looks.

    An entry of bytes (uint8) with at least three dimensions is one: ``[..., H, W, C]`` or
    ``[..., C, H, W]``. Of the last three dimensions the channels are the first or the last,
    whichever is smaller, and the last of two that are equal. Whatever stands before the last three
    are frames, which are channels too.

    Args:
        shape: Of the entry, without batch dimensions.
        dtype: Of the entry.
    """
    if dtype != torch.uint8 or len(shape) < 3:
        return "none"
    return "first" if shape[-3] < shape[-1] else "last"
