"""The global generators, which any environment may draw from."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torchrl.checkpoint import GlobalRNGState

__all__ = ["Generators", "isolated_generators", "seed_generators"]


class Generators(GlobalRNGState):
    """The global generators of Python, NumPy, torch and its devices, as checkpoints have them."""

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        """Restore them; of the GPUs those that this machine shows, which may be fewer by now."""
        state = dict(state_dict)
        gpus = list(state.pop("torch_cuda", ()))[: torch.cuda.device_count()]
        super().load_state_dict(state | ({"torch_cuda": gpus} if gpus else {}))


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
