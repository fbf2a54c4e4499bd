"""The global generators, which any environment may draw from."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torchrl.checkpoint import GlobalRNGState

__all__ = ["isolated_generators", "seed_generators"]


def seed_generators(seed: int) -> None:
    """Seed the global generators of Python, NumPy and torch."""
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - the global one
    torch.manual_seed(seed)


@contextmanager
def isolated_generators(seed: int) -> Iterator[None]:
    """Seed the global generators of Python, NumPy and torch, and put them back afterwards.

    Learning goes on as if nothing had been played, and an environment that draws from a global
    generator draws the same for every policy.
    """
    before = GlobalRNGState().state_dict()
    seed_generators(seed)
    try:
        yield
    finally:
        GlobalRNGState().load_state_dict(before)
