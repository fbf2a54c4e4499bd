"""Masks of slots: which environments of a batch are reset or stepped."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

__all__ = ["merge", "reset_mask", "step_mask"]


def reset_mask(tensordict: TensorDictBase, batch: torch.Size) -> Tensor | None:
    """Return which slots are reset, bool ``[*batch]``, or None for all of them.

    Args:
        tensordict: Input of the reset; it may hold "_reset" entries at any level.
        batch: Batch size of the environment.
    """
    mask: Tensor | None = None
    for key in tensordict.keys(True, True):
        if (key if isinstance(key, str) else key[-1]) == "_reset":
            value = tensordict.get(key).reshape(*batch, -1).any(-1)
            mask = value if mask is None else mask | value
    return None if mask is None or mask.all() else mask


def step_mask(tensordict: TensorDictBase, batch: torch.Size) -> Tensor | None:
    """Return which slots are stepped, bool ``[*batch]``, or None for all of them."""
    mask = tensordict.get("_step", None)
    return None if mask is None else mask.reshape(batch)


def merge(mask: Tensor, where_true: Any, where_false: Any) -> Any:
    """Pick slot by slot from tensors ``[*batch, ...]``, or from (nested) dictionaries of them.

    Args:
        mask: Slots of the first choice, bool ``[*batch]``.
        where_true: Values where the mask is True.
        where_false: Values elsewhere, with the same names and shapes.
    """
    if isinstance(where_true, Tensor):
        trailing = (1,) * (where_true.ndim - mask.ndim)
        return torch.where(mask.reshape(mask.shape + trailing), where_true, where_false)
    if isinstance(where_true, TensorDictBase):
        return where_true.apply(lambda one, other: merge(mask, one, other), where_false)
    return {name: merge(mask, value, where_false[name]) for name, value in where_true.items()}
