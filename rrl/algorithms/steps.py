"""Gradient steps one after the other, eager or as one compiled graph."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn

from rrl.algorithms.compilation import CompiledUpdate, can_compile

Step = Callable[[TensorDictBase], dict[str, Tensor]]
"""One gradient update, of a batch ``[S, B]``, to metrics ``[S]``."""


class GradientSteps:
    """Takes a sequence of steps, each with a batch of its own.

    Args:
        module: owns the tensors that the steps change.
        compiled: make one graph of each kind of sequence, where there is a compiler.

    """

    def __init__(self, module: nn.Module, compiled: bool) -> None:
        self._module = module
        self._graphs: dict[Any, CompiledUpdate] | None = {} if compiled and can_compile() else None

    @property
    def compile_seconds(self) -> float:
        """Seconds that compiling has taken so far."""
        return sum(graph.compile_seconds for graph in (self._graphs or {}).values())

    def __call__(
        self, steps: Sequence[Step], keys: tuple[NestedKey, ...], columns: Sequence[Tensor]
    ) -> dict[str, Tensor]:
        """Take the steps, each with its row of the entries ``columns`` ``[n, S, B, ...]``; metrics ``[<= n, S]``."""
        update = partial(_take, steps, keys)
        if self._graphs is None:
            return update(*columns)
        kind = (
            tuple(step.__name__ for step in steps),
            keys,
            tuple(column.shape for column in columns),
        )
        if kind not in self._graphs:
            self._graphs[kind] = CompiledUpdate(update, self._module)
        return self._graphs[kind](*columns)


def _take(
    steps: Sequence[Step], keys: tuple[NestedKey, ...], *columns: Tensor
) -> dict[str, Tensor]:
    history: dict[str, list[Tensor]] = {}
    for step, *row in zip(steps, *columns, strict=True):
        batch = TensorDict(dict(zip(keys, row, strict=True)), row[0].shape[:2])
        for name, value in step(batch).items():
            history.setdefault(name, []).append(value)
    return {name: torch.stack(values) for name, values in history.items()}
