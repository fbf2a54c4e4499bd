"""A chain as one graph, with the entries and the state that it needs."""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.export import ExportedProgram
from torch.export.graph_signature import OutputKind
from torch.fx import Node

from rrl.deploy.contract import ARCHIVE, COMMAND, MODEL, graph_inputs, graph_outputs

from .chain import Chain, Values
from .portable import PORTABLE

SHAPE_ALONE = {"zeros_like", "ones_like", "full_like", "empty_like"}
"""Operations that read nothing of a tensor but its shape."""


@dataclass(frozen=True)
class Traced:
    """One control step as a graph of tensor operations.

    Inputs are the entries, then the state; outputs the command, the reports, the next state.

    Attributes:
        program: The graph.
        entries: Every entry that it reads, zeros.
        state: The initial state.
        reports: What it tells beside the command, zeros.
        command: The command, zeros.
    """

    program: ExportedProgram
    entries: Values
    state: Values
    reports: Values
    command: Tensor

    @property
    def inputs(self) -> list[str]:
        """The names of the inputs in their order."""
        return graph_inputs(list(self.entries), list(self.state))

    @property
    def outputs(self) -> list[str]:
        """The names of the outputs in their order."""
        return graph_outputs(list(self.reports), list(self.state))

    def save(self, folder: Path) -> None:
        """Write ``policy.pt2`` and ``policy.onnx``."""
        with quiet():
            torch.export.save(self.program, folder / ARCHIVE)
            model = torch.onnx.export(
                self.program,
                dynamo=True,
                input_names=self.inputs,
                output_names=self.outputs,
                verbose=False,
            )
            assert model is not None
            for node in model.model.graph:
                node.metadata_props.clear()  # where in the source it came from
            model.save(folder / MODEL)


class _Step(nn.Module):
    """A chain's step as a module of plain tensors."""

    def __init__(self, chain: Chain, entries: Sequence[str], state: Sequence[str]) -> None:
        super().__init__()
        self._chain, self._entries, self._state = chain, entries, state

    def forward(self, *values: Tensor) -> tuple[Tensor, ...]:
        given = dict(zip([*self._entries, *self._state], values, strict=True))
        entries = {name: given[name] for name in self._entries}
        told, following = self._chain.step(entries, {**self._chain.initial, **given})
        return (*told.values(), *(following[name] for name in self._state))


def trace(chain: Chain) -> Traced:
    """Record a chain's step, once with everything and then with what matters.

    Raises:
        Exception: Of any kind, if a part cannot be recorded: it decides by numbers, leaves torch,
            or keeps a memory that it does not declare.
    """
    needed = _needed(_program(chain, list(chain.entries), list(chain.initial)), chain)
    entries = [name for name in chain.entries if name in needed]
    state = [name for name in chain.initial if name in needed]
    program = _program(chain, entries, state)
    told, _ = chain.step(chain.entries, chain.initial)
    return Traced(
        program,
        {name: chain.entries[name] for name in entries},
        {name: chain.initial[name] for name in state},
        {name: told[name] for name in chain.reports},
        told[COMMAND],
    )


def _program(chain: Chain, entries: list[str], state: list[str]) -> ExportedProgram:
    examples = [chain.entries[name] for name in entries] + [chain.initial[name] for name in state]
    with quiet(), torch.no_grad():
        step = _Step(chain, entries, state)
        program = torch.export.export(step, tuple(v.clone() for v in examples), strict=False)
        program = program.run_decompositions(PORTABLE)
    outputs = program.graph_signature.output_specs
    written = [s.arg.name for s in outputs if s.kind != OutputKind.USER_OUTPUT]
    if written:
        raise ValueError(f"expected no memory but a controller's state, got {written}")
    for node in program.graph.nodes:
        node.meta.pop("stack_trace", None)  # where in the source it came from
    return program


def _needed(program: ExportedProgram, chain: Chain) -> set[str]:
    """Return the inputs that the outputs depend on, now or later."""
    names = [*chain.entries, *chain.initial]
    inputs = dict(zip(program.graph_signature.user_inputs, names, strict=True))
    reads: dict[Node, set[str]] = {}
    for node in program.graph.nodes:
        if node.op == "placeholder":
            reads[node] = {inputs[node.name]} if node.name in inputs else set()
        elif node.op != "output":
            reads[node] = set() if _ignores(node) else _union(reads, node.all_input_nodes)
    results = program.graph.output_node().args[0]
    told, following = results[: -len(chain.initial)], results[-len(chain.initial) :]
    needed = _union(reads, told)
    while True:
        kept = [n for name, n in zip(chain.initial, following, strict=True) if name in needed]
        if (more := needed | _union(reads, kept)) == needed:
            return needed
        needed = more


def _ignores(node: Node) -> bool:
    """Return whether a node's numbers do not depend on its inputs'."""
    value = node.meta.get("val")
    empty = isinstance(value, Tensor) and value.numel() == 0
    return empty or getattr(node.target, "__name__", "").partition(".")[0] in SHAPE_ALONE


def _union(reads: dict[Node, set[str]], nodes: Sequence[Node]) -> set[str]:
    return set().union(*(reads[node] for node in nodes))


@contextmanager
def quiet() -> Iterator[None]:
    """Keep what the exporters say off the terminal, such as a graph that cannot be recorded."""
    disabled = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings(), redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(disabled)
