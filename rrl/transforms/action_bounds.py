"""Bounds of an action, and the range that a normalised action unit stands for."""

from __future__ import annotations

from typing import NamedTuple

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec, Unbounded

__all__ = ["ActionLimits", "action_leaf", "limits_of", "unbounded_like"]


class ActionLimits(NamedTuple):
    """Bounds of one action entry.

    ``half_range`` is (high - low) / 2, what one normalised action unit stands for. A dimension
    without bounds has the limits -inf and inf and counts as normalised already, with a half range
    of 1.
    """

    low: Tensor
    high: Tensor
    half_range: Tensor
    shape: torch.Size
    dtype: torch.dtype


def action_leaf(action_spec: Composite, key: NestedKey) -> TensorSpec:
    """Return the spec of one action entry.

    Raises:
        KeyError: If there is no such action.
        TypeError: If it is not a floating point action.

    """
    if key not in action_spec.keys(True, True):
        raise KeyError(
            f"The environment has no action {key!r}. "
            f"Available actions: {sorted(map(str, action_spec.keys(True, True)))}."
        )
    spec = action_spec[key]
    if not spec.dtype.is_floating_point:
        raise TypeError(
            f"A continuous action was expected at {key!r}, got a {type(spec).__name__} spec of dtype {spec.dtype}."
        )
    return spec


def limits_of(spec: TensorSpec) -> ActionLimits:
    """Return the limits of an action spec; each tensor has the spec's shape."""
    if isinstance(spec, Bounded):
        low, high = spec.space.low, spec.space.high
        largest = torch.finfo(spec.dtype).max
        # TorchRL writes "unbounded" as the largest number of the dtype.
        low = torch.where(low <= -largest, -torch.inf, low)
        high = torch.where(high >= largest, torch.inf, high)
    else:
        low = torch.full(spec.shape, -torch.inf, dtype=spec.dtype, device=spec.device)
        high = -low
    half_range = (high - low) / 2
    half_range = torch.where(half_range.isfinite(), half_range, torch.ones_like(half_range))
    return ActionLimits(low, high, half_range, spec.shape, spec.dtype)


def unbounded_like(spec: TensorSpec) -> Unbounded:
    """Return a spec of the same shape, dtype and device without bounds.

    Raises:
        TypeError: If the spec is not one of floating point numbers.

    """
    if not spec.dtype.is_floating_point:
        raise TypeError(f"A floating point observation was expected, got dtype {spec.dtype}.")
    return Unbounded(shape=spec.shape, dtype=spec.dtype, device=spec.device)
