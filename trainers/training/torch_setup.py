"""Torch's settings for the whole process: generators, threads, precision."""

from __future__ import annotations

import warnings

import numpy as np
import torch

from ..generators import seed_generators
from ..settings import TrainerSettings

COLLECTOR_OFFSET = 2**30
"""Apart from every seed that a user can name."""


def configure_torch(
    settings: TrainerSettings, *, collects_only: bool = False, env_steps: int = 0
) -> None:
    """Set threads and precision, and seed the generators of Python, NumPy and torch.

    Args:
        settings: Of the run.
        collects_only: Whether this process only collects, and draws other numbers than the learner.
        env_steps: Environment steps before this process; after each number of them others are
            drawn.
    """
    seed = settings.seed + COLLECTOR_OFFSET * collects_only
    if env_steps:
        seed = int(np.random.SeedSequence([seed, env_steps]).generate_state(1)[0])
    seed_generators(seed)
    torch.set_num_threads(settings.threads)
    torch.set_float32_matmul_precision(settings.matmul_precision)
    if settings.flush_denormals and not torch.set_flush_denormal(True):
        warnings.warn("flush_denormals: this processor cannot; going on without", stacklevel=2)
