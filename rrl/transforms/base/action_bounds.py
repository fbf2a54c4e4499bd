"""Bounds of an action, and the range that a normalized action unit stands for."""

from __future__ import annotations

from typing import NamedTuple

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import Bounded, Composite, TensorSpec

UNBOUNDED = 1e10
"""Bounds of this size are none: dm_control writes so where an actuator has no range."""


class ActionLimits(NamedTuple):
    """Bounds of one action entry, tensors of the entry's shape.

    ``half_range`` is (high - low) / 2, what one normalized action unit stands for. A dimension
    without bounds has the limits -inf and inf and counts as normalized already, with a half range
    of 1.
    """

    low: Tensor
    high: Tensor
    half_range: Tensor
    shape: torch.Size
    dtype: torch.dtype

    @property
    def middle(self) -> Tensor:
        """Of a dimension without two bounds: the number within them that is nearest to 0."""
        middle = self.low / 2 + self.high / 2
        nearest = torch.zeros_like(middle).clamp(self.low, self.high)
        return torch.where(middle.isfinite(), middle, nearest)

    def slot_middle(self, batch_dims: int) -> Tensor:
        """Return the middle of one slot's bounds, ``[n_act]``; all slots have the same."""
        return self.middle[(0,) * batch_dims]


def action_leaf(action_spec: Composite, key: NestedKey) -> TensorSpec:
    """Return the spec of one action entry.

    Raises:
        KeyError: If there is no such action.
        TypeError: If it is not a floating point action.
        ValueError: If it is a number without a dimension of its own.
    """
    present = action_spec.keys(True, True)
    if key not in present:
        raise KeyError(f"action_key: expected one of {sorted(map(str, present))}, got {key!r}")
    spec = action_spec[key]
    if not spec.dtype.is_floating_point:
        raise TypeError(
            f"{key!r}: expected a continuous action, got a {type(spec).__name__} spec of dtype "
            f"{spec.dtype}"
        )
    batch = tuple(action_spec.shape)
    if spec.ndim <= len(batch):
        raise ValueError(
            f"{key!r}: expected an action of shape [*batch, n], got {tuple(spec.shape)} with the "
            f"batch size {batch}; give the environment's action a dimension of size 1"
        )
    return spec


def limits_of(spec: TensorSpec) -> ActionLimits:
    """Return the limits of an action spec; each tensor has the spec's shape.

    Raises:
        ValueError: If a lower bound is above the upper one.
    """
    if isinstance(spec, Bounded):
        low, high = spec.space.low, spec.space.high
        if (low > high).any():
            raise ValueError(
                "action: expected bounds with low no more than high, got "
                f"{low.tolist()} and {high.tolist()}"
            )
        # TorchRL writes "unbounded" as the largest number of a dtype.
        largest = min(torch.finfo(spec.dtype).max, UNBOUNDED)
        low = torch.where(low <= -largest, -torch.inf, low)
        high = torch.where(high >= largest, torch.inf, high)
    else:
        low = torch.full(spec.shape, -torch.inf, dtype=spec.dtype, device=spec.device)
        high = -low
    half_range = (high - low) / 2
    half_range = torch.where(half_range.isfinite(), half_range, torch.ones_like(half_range))
    return ActionLimits(low, high, half_range, spec.shape, spec.dtype)


def share_within(change: Tensor, limit: Tensor) -> Tensor:
    """Return what part of a change ``[*batch, n]`` keeps to a limit in every dimension.

    A dimension with a limit of 0 has no range: it goes nowhere, and holds up no other.

    Returns:
        ``[*batch, 1]``, at least 0; 1 and more: the whole change does.
    """
    parts = limit / change.abs().clamp_min(torch.finfo(change.dtype).tiny)
    return torch.where(limit == 0, torch.inf, parts).amin(-1, keepdim=True)
