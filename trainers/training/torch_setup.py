"""Settings that hold for the whole process."""

from __future__ import annotations

import random
import warnings

import numpy as np
import torch

from rrl.threads import available_threads

from ..settings import TrainerSettings

MOST_THREADS = 2
"""Torch threads unless told otherwise: what was measured; products of small networks cannot use many."""


def configure_process(settings: TrainerSettings) -> None:
    """Threads, precision, and the global generators, for whatever in an environment draws from them."""
    random.seed(settings.seed)
    np.random.seed(settings.seed)  # noqa: NPY002
    torch.manual_seed(settings.seed)
    torch.set_num_threads(
        settings.threads or (1 if settings.overlap else min(MOST_THREADS, available_threads()))
    )
    torch.set_float32_matmul_precision(_precision(settings))
    if settings.flush_denormals and not torch.set_flush_denormal(True):
        warnings.warn(
            "this processor cannot flush denormal numbers; going on without", stacklevel=2
        )


def _precision(settings: TrainerSettings) -> str:
    """What was asked for; float32 where bfloat16 products would be the slower ones."""
    if settings.matmul_precision != "medium" or torch.cpu._is_amx_tile_supported():
        return settings.matmul_precision
    warnings.warn(
        "trainer.matmul_precision=medium: this processor has no AMX, without which bfloat16 products are slower than "
        "float32 ones; going on with highest",
        stacklevel=3,
    )
    return "highest"
