"""Checks of parameters that are a number or one number for each dimension."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

__all__ = ["check_length", "per_dimension"]


def per_dimension(
    name: str,
    value: float | Sequence[float] | Tensor,
    *,
    minimum: float | None = None,
    positive: bool = False,
) -> Tensor:
    """Make a float32 tensor ``[]`` or ``[n]`` from a number or one number for each dimension.

    Raises:
        ValueError: If it is neither, not finite, below the minimum, or not positive but must be.

    """
    try:
        tensor = torch.as_tensor(value, dtype=torch.float32).detach().clone()
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(
            f"{name} must be a number or a list with one number a dimension, got {value!r}."
        ) from None
    if tensor.ndim > 1 or tensor.numel() == 0:
        raise ValueError(
            f"{name} must be a number or a list with one number a dimension, got {value!r}."
        )
    if not tensor.isfinite().all():
        raise ValueError(f"{name} must be finite, got {value!r}.")
    if minimum is not None and (tensor < minimum).any():
        raise ValueError(f"{name} must be at least {minimum:g}, got {value!r}.")
    if positive and not (tensor > 0).all():
        raise ValueError(f"{name} must be positive, got {value!r}.")
    return tensor


def check_length(name: str, value: Tensor, size: int, what: str) -> None:
    """Raise a ValueError unless ``value`` is one number or has one a dimension."""
    if value.ndim and value.shape[-1] != size:
        raise ValueError(f"{name} has {value.shape[-1]} numbers, {what} has {size} dimensions.")


def check(name: str, value: object, expected: str, fine: bool) -> None:
    """Raise a ValueError that names a hyperparameter, unless it is fine."""
    if not fine:
        raise ValueError(f"{name}: expected {expected}, got {value!r}")
