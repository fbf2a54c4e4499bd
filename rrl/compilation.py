"""Compiling an update: loss, gradients, optimiser and targets in one graph."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FunctionType, MethodType
from typing import Any

import torch


def compiler_problem() -> str | None:
    """Why nothing can be compiled on this machine; None if it can."""
    from torch._inductor.cpp_builder import get_cpp_compiler

    try:
        get_cpp_compiler()
    except Exception as error:  # of an internal kind that moves between versions
        return f"{type(error).__name__}: {error}".strip().partition("\n")[0]
    return None


def compile_where_possible(steps: Sequence[Callable[..., Any]]) -> list[Callable[..., Any]]:
    """:func:`compile_update` for each of ``steps``; as they are, with one warning, where there is no C++ compiler."""
    problem = compiler_problem()
    if problem is None:
        return [compile_update(step) for step in steps]
    warnings.warn(
        f"the update is not compiled and takes two to three times as long: no C++ compiler ({problem}); install g++, "
        "or set compiled=false to do without",
        stacklevel=2,
    )
    return list(steps)


def compile_update(update: Callable[..., Any]) -> Callable[..., Any]:
    """Compile ``update`` into one graph without breaks.

    Gradients are taken with :func:`torch.autograd.grad`, which Dynamo traces on request. Guards are skipped: the
    caller promises shapes, dtypes and parameters that never change, which holds for a training run. Dynamo keeps what
    it compiled by code object; each learner gets one of its own, or without guards it would run another learner's.

    Args:
        update: a bound method.
    """
    torch._dynamo.config.trace_autograd_ops = True
    os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", str(_cache() / "inductor"))  # PyTorch's own is in /tmp
    compiled = torch.compile(
        _with_own_code(update),
        fullgraph=True,
        dynamic=False,
        options={
            "cpp_wrapper": True,
            "guard_filter_fn": torch.compiler.skip_all_guards_unsafe,
        },
    )
    return _quiet_at_first(compiled)


def _quiet_at_first(step: Callable[..., Any]) -> Callable[..., Any]:
    """Hold back what the libraries' code warns about while it is traced, at the first call; none of it is ours."""
    traced = False

    def run(*arguments: Any) -> Any:
        nonlocal traced
        if traced:
            return step(*arguments)
        traced = True
        with warnings.catch_warnings(record=True):
            warnings.simplefilter("ignore")
            return step(*arguments)

    return run


def _with_own_code(method: Any) -> Callable[..., Any]:
    f = method.__func__
    copy = FunctionType(f.__code__.replace(), f.__globals__, f.__name__, f.__defaults__, f.__closure__)
    return MethodType(copy, method.__self__)


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rrl"
