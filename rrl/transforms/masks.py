"""Which slots of a batch a reset or a step concerns."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

__all__ = ["merge", "reset_mask", "step_mask"]


def reset_mask(tensordict: TensorDictBase, batch: torch.Size) -> Tensor | None:
    """Return which slots are being reset, bool ``[*batch]``, or None for all of them.

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
    """Return which slots are being stepped, bool ``[*batch]``, or None for all of them."""
    mask = tensordict.get("_step", None)
    return None if mask is None else mask.reshape(batch)


def merge(mask: Tensor, where_true: Tensor, where_false: Tensor) -> Tensor:
    """Pick slot by slot; ``mask`` is ``[*batch]``, the others are ``[*batch, ...]``."""
    trailing = (1,) * (where_true.ndim - mask.ndim)
    return torch.where(mask.reshape(mask.shape + trailing), where_true, where_false)
