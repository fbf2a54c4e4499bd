"""Compiling an update: loss, gradients, optimiser and targets in one graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch


def compile_update(update: Callable[..., Any]) -> Callable[..., Any]:
    """Compile ``update`` into one graph without breaks.

    Gradients are taken with :func:`torch.autograd.grad`, which Dynamo traces on request. Guards are skipped: the
    caller promises shapes, dtypes and parameters that never change, which holds for a training run.
    """
    torch._dynamo.config.trace_autograd_ops = True
    return torch.compile(
        update,
        fullgraph=True,
        dynamic=False,
        options={
            "cpp_wrapper": True,
            "guard_filter_fn": torch.compiler.skip_all_guards_unsafe,
        },
    )
