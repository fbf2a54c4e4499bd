"""Gradient steps one after the other, eager or as one compiled graph."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor, nn

from rrl.algorithms.compilation import (
    CompiledUpdate,
    compiler_problem,
    find_vector_instructions,
)
from rrl.algorithms.products import bfloat16_problem

UPDATES_PER_GRAPH = 4
"""At most: every further one saves less time in a call and takes as long to compile."""

Kind = Literal["critics", "targets", "policy"]
"""What moves in a step: the critics, their targets with them, or the policy too."""

Step = Callable[[Kind, TensorDictBase], dict[str, Tensor]]
"""One gradient step of a batch ``[B]``, to scalar metrics."""


class Updates:
    """Takes a sequence of steps, each with a batch of its own.

    Args:
        module: Owns the tensors that the steps change.
        step: Takes one step.
        compiled: Make one graph of each kind of sequence; eager where that is not possible.
        bfloat16: Multiply matrices in bfloat16 in these graphs, where that is not slower.
    """

    def __init__(self, module: nn.Module, step: Step, compiled: bool, bfloat16: bool) -> None:
        self._module, self._step = module, step
        problem = compiler_problem() if compiled else None
        if problem is not None:
            warnings.warn(
                "the update is not compiled and takes two to three times as long: "
                f"{problem}, or set compiled=false to do without",
                stacklevel=2,
            )
        self._graphs: dict[Any, CompiledUpdate] = {}
        self._compiled, self._bfloat16 = compiled and problem is None, bfloat16
        if self._compiled:
            find_vector_instructions()  # while the first transitions are collected

    @property
    def compile_seconds(self) -> float:
        """Seconds that compiling has taken so far."""
        return sum(graph.compile_seconds for graph in self._graphs.values())

    def __call__(
        self, kinds: tuple[Kind, ...], keys: tuple[NestedKey, ...], columns: Sequence[Tensor]
    ) -> dict[str, Tensor]:
        """Take ``n`` steps, each with its row of the entries ``columns`` [n, B, ...].

        Returns:
            Metrics, at most ``[n]`` each.
        """
        update = partial(self._take, kinds, keys)
        if not self._compiled:
            return update(*columns)
        sort = kinds, keys, tuple(column.shape for column in columns)
        if sort not in self._graphs:
            self._check_bfloat16(columns[0].device)
            self._graphs[sort] = CompiledUpdate(update, self._module, self._bfloat16)
        graph = self._graphs[sort]
        values = graph(*columns)
        self._compiled = not graph.failed  # one warning, not one a graph
        return values

    def _check_bfloat16(self, device: torch.device) -> None:
        problem = bfloat16_problem(device) if self._bfloat16 else None
        if problem is not None:
            warnings.warn(f"products: {problem}; going on with float32", stacklevel=4)
            self._bfloat16 = False

    def _take(
        self, kinds: tuple[Kind, ...], keys: tuple[NestedKey, ...], *columns: Tensor
    ) -> dict[str, Tensor]:
        history: dict[str, list[Tensor]] = {}
        for kind, *row in zip(kinds, *columns, strict=True):
            batch = TensorDict(dict(zip(keys, row, strict=True)), row[0].shape[:1])
            for name, value in self._step(kind, batch).items():
                history.setdefault(name, []).append(value)
        return {name: torch.stack(values) for name, values in history.items()}
