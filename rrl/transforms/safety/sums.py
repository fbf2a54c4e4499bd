"""Sums that are the same to the last bit wherever a limit runs.

A library's sum and norm add in an order of its own, with wider numbers in between. A limit runs in
the trainer and, exported, in another runtime, and both should command the same. IEEE 754 defines
additions, products and quotients of single numbers to the last bit, so the order is fixed here.
"""

from __future__ import annotations

import torch
from torch import Tensor


def total(values: Tensor, dim: int = -1) -> Tensor:
    """Return the sum over a dimension, added from first to last; zeros if it is empty."""
    if values.shape[dim] == 0:
        return values.sum(dim)
    first, *others = values.unbind(dim)
    for value in others:
        first = first + value
    return first


def dot(x: Tensor, y: Tensor) -> Tensor:
    """Return the inner product of vectors ``[*batch, n]`` as ``[*batch, 1]``."""
    return total(x * y).unsqueeze(-1)


def norm(x: Tensor) -> Tensor:
    """Return the length of vectors ``[*batch, n]`` as ``[*batch, 1]``."""
    # Torch's root may be wrong in the last bit. Taken in double precision and rounded, it is right
    # for single precision.
    return torch.sqrt(dot(x, x).double()).to(x)
