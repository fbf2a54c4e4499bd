"""All numbers of a policy as one vector, for another process that has the same policy."""

from __future__ import annotations

import torch
from torch import Tensor


def flatten(policy: torch.nn.Module) -> Tensor:
    """Return parameters and buffers in one vector, a copy on the CPU."""
    return torch.cat([tensor.flatten().cpu() for tensor in _tensors(policy)])


def assign(policy: torch.nn.Module, vector: Tensor) -> None:
    """Put :func:`flatten`'s numbers in place."""
    tensors = _tensors(policy)
    for tensor, part in zip(tensors, vector.split([t.numel() for t in tensors]), strict=True):
        tensor.copy_(part.view_as(tensor))


def _tensors(policy: torch.nn.Module) -> list[Tensor]:
    return [tensor.data for tensor in (*policy.parameters(), *policy.buffers())]
