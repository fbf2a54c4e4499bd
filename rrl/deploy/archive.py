"""``policy.pt2`` in the place of ``policy.onnx``, for robots that have torch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from rrl.deploy.contract import ARCHIVE, graph_file, read_contract
from rrl.deploy.policy import Arrays, Graph


def torch_graph(folder: str | Path) -> Graph:
    """Load ``policy.pt2``, for ``Policy(folder, rate, graph=torch_graph(folder))``.

    Raises:
        FileNotFoundError: If the folder holds no exported policy, or not this graph.
        ValueError: If a file was changed, or is of another format.
    """
    contract = read_contract(folder)
    module = torch.export.load(graph_file(folder, ARCHIVE)).module()
    return module_graph(module, contract.inputs, contract.outputs)


def module_graph(
    module: Callable[..., Any], inputs: Sequence[str], outputs: Sequence[str]
) -> Graph:
    """Return a graph that calls a module of tensors, with the names of its inputs and outputs."""

    def run(values: Arrays) -> Arrays:
        with torch.no_grad():
            results = module(*(torch.from_numpy(values[name]) for name in inputs))
        # Copies: results may share the graph's memory, and a robot may write into its command.
        return {name: value.numpy().copy() for name, value in zip(outputs, results, strict=True)}

    return run
