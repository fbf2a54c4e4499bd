"""Compiling an update: loss, gradients, optimiser and targets in one graph."""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType, MethodType
from typing import Any

import torch


def compile_update(update: Callable[..., Any]) -> Callable[..., Any]:
    """Compile ``update`` into one graph without breaks.

    Gradients are taken with :func:`torch.autograd.grad`, which Dynamo traces on request. Guards are skipped: the
    caller promises shapes, dtypes and parameters that never change, which holds for a training run. Dynamo keeps what
    it compiled by code object; each learner gets one of its own, or without guards it would run another learner's.

    Args:
        update: a bound method.
    """
    torch._dynamo.config.trace_autograd_ops = True
    return torch.compile(
        _with_own_code(update),
        fullgraph=True,
        dynamic=False,
        options={
            "cpp_wrapper": True,
            "guard_filter_fn": torch.compiler.skip_all_guards_unsafe,
        },
    )


def _with_own_code(method: Any) -> Callable[..., Any]:
    f = method.__func__
    copy = FunctionType(f.__code__.replace(), f.__globals__, f.__name__, f.__defaults__, f.__closure__)
    return MethodType(copy, method.__self__)
