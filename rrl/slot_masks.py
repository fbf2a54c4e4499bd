"""Masks of slots: which environments of a batch are reset or stepped, and whose episodes end."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from rrl.keys import leaf


def reset_mask(tensordict: TensorDictBase, batch: torch.Size) -> Tensor | None:
    """Return which slots are reset, bool ``[*batch]``, or None for all of them.

    Args:
        tensordict: Input of the reset; it may hold "_reset" entries at any level.
        batch: Batch size of the environment.
    """
    mask: Tensor | None = None
    for key in _leaves(tensordict, "_reset"):
        value = tensordict.get(key).reshape(*batch, -1).any(-1)
        mask = value if mask is None else mask | value
    return None if mask is None or mask.all() else mask


def step_mask(tensordict: TensorDictBase, batch: torch.Size) -> Tensor | None:
    """Return which slots are stepped, bool ``[*batch]``, or None for all of them."""
    mask = tensordict.get("_step", None)
    return None if mask is None else mask.reshape(batch)


def resets_itself(env: EnvBase) -> bool:
    """Return whether it starts the next episode within the step that ends one."""
    return bool(env.__dict__.get("_torchrl_native_autoreset", False))


def any_done(tensordict: TensorDictBase) -> Tensor:
    """Return which slots end an episode, bool ``[*batch]``."""
    batch = tensordict.batch_size
    done = torch.zeros(batch, dtype=torch.bool, device=tensordict.device)
    for key in _leaves(tensordict, "done"):
        done = done | tensordict.get(key).reshape(*batch, -1).any(-1)
    return done


def truncate(tensordict: TensorDictBase, ends: Tensor) -> None:
    """End the episodes of the slots in ``ends``, bool ``[*batch, ..., 1]``."""
    batch = tensordict.batch_size
    for key in list(_leaves(tensordict, "done", "truncated")):
        flag = tensordict.get(key)
        own = ends if ends.shape == flag.shape else ends.reshape(*batch, -1).any(-1)
        tensordict.set(key, flag | shaped_like(flag, own))


def shaped_like(value: Tensor, mask: Tensor) -> Tensor:
    """Return a mask of slots, bool ``[*batch]``, with as many dimensions as ``value`` has."""
    return mask.reshape(mask.shape + (1,) * (value.ndim - mask.ndim))


def merge(mask: Tensor, where_true: Any, where_false: Any) -> Any:
    """Pick slot by slot from tensors ``[*batch, ...]``, or from (nested) dictionaries of them.

    Args:
        mask: Slots of the first choice, bool ``[*batch]``.
        where_true: Values where the mask is True.
        where_false: Values elsewhere, with the same names and shapes.
    """
    if isinstance(where_true, Tensor):
        return torch.where(shaped_like(where_true, mask), where_true, where_false)
    if isinstance(where_true, TensorDictBase):
        return where_true.apply(lambda one, other: merge(mask, one, other), where_false)
    return {name: merge(mask, value, where_false[name]) for name, value in where_true.items()}


def _leaves(tensordict: TensorDictBase, *names: str) -> Iterator[NestedKey]:
    """Yield the keys of these names, at any level."""
    return (key for key in tensordict.keys(True, True) if leaf(key) in names)
