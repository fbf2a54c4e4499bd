"""Compiling an update: losses, gradients, optimisers and targets in one graph."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
import torch._inductor
from torch import Tensor, nn
from torch.fx import GraphModule, Node
from torch.fx.experimental.proxy_tensor import get_proxy_mode, make_fx

__all__ = ["CompiledUpdate", "being_traced", "can_compile", "compiler_problem", "import_compiler"]

log = logging.getLogger(__name__)

Update = Callable[..., dict[str, Tensor]]
"""Of tensors, to metrics; changes tensors that it holds on to (parameters, moments, targets) in place."""


def compiler_problem() -> str | None:
    """Why nothing can be compiled on this machine; None if it can."""
    from torch._inductor.cpp_builder import get_cpp_compiler

    try:
        get_cpp_compiler()
    except Exception as error:  # of an internal kind that moves between versions
        return f"{type(error).__name__}: {error}".strip().partition("\n")[0]
    return None


def can_compile() -> bool:
    """Whether there is a C++ compiler; warns if there is none."""
    problem = compiler_problem()
    if problem is not None:
        warnings.warn(
            f"the update is not compiled and takes two to three times as long: no C++ compiler ({problem}); install "
            "g++, or set compiled=false to do without",
            stacklevel=2,
        )
    return problem is None


def import_compiler() -> None:
    """Import the compiler and have it look at the processor, two seconds or so, while something else is awaited."""
    _choose_cache()
    with (
        warnings.catch_warnings(),
        contextlib.suppress(ImportError, AttributeError),
    ):  # private, of a version
        warnings.simplefilter("ignore", DeprecationWarning)  # of PyTorch's modules, at one another
        if compiler_problem() is None:
            for module in ("torch._inductor.compile_fx", "torch._dynamo.repro.after_dynamo"):
                importlib.import_module(module)
            importlib.import_module("torch._inductor.cpu_vec_isa").pick_vec_isa()


def being_traced() -> bool:
    """Whether the running code is recorded for a :class:`CompiledUpdate`."""
    return get_proxy_mode() is not None


class CompiledUpdate:
    """An update as one compiled graph, made at the first call.

    The update is run once on tensors without data, which records what its losses, gradients and optimisers do as a list
    of operations (:func:`torch.fx.experimental.proxy_tensor.make_fx`). Python that an update runs each time, a
    TensorDict's and TorchRL's, leaves no trace in it, which is why this is faster than to have :func:`torch.compile`
    follow the same code; :func:`torch._inductor.compile`, its back half, takes the recorded graph. Tensors that the
    update holds on to become arguments of the graph; it changes them in place.

    Args:
        update: takes tensors whose shapes never change, does the same operations every time, and holds on to the same
            tensors for good.
        module: owns the tensors that the update changes; they must be in its ``state_dict``.
    """

    def __init__(self, update: Update, module: nn.Module) -> None:
        self._update, self._module = update, module
        self._names: list[str] = []
        self._state: list[Tensor] = []
        self._run: Callable[..., Sequence[Tensor]] | None = None
        self.compile_seconds = 0.0

    def __call__(self, *tensors: Tensor) -> dict[str, Tensor]:
        """Do what the update does."""
        if self._run is None:
            self._run = self._compile(tensors)
        return dict(zip(self._names, self._run(*tensors, *self._state), strict=True))

    def _compile(self, tensors: tuple[Tensor, ...]) -> Callable[..., Sequence[Tensor]]:
        log.info(
            "compiling the update: half a minute with settings new to this machine, else seconds"
        )
        start = time.perf_counter()
        with warnings.catch_warnings():  # of the libraries' code, which is not ours to mend
            warnings.simplefilter("ignore")
            graph = self._trace(tensors)
            run = _compile(graph, [*tensors, *self._state])
        self.compile_seconds = time.perf_counter() - start
        return run

    def _trace(self, tensors: tuple[Tensor, ...]) -> GraphModule:
        def values(*arguments: Tensor) -> list[Tensor]:
            metrics = self._update(*arguments)
            self._names = list(metrics)
            return list(metrics.values())

        # what involves no tensor of the batch, such as the targets' step, is not only recorded but done
        owned = [value for value in self._module.state_dict().values() if isinstance(value, Tensor)]
        before = [value.clone() for value in owned]
        graph = make_fx(values, tracing_mode="fake", _allow_non_fake_inputs=True)(*tensors)
        for value, old in zip(owned, before, strict=True):
            value.copy_(old)
        graph, self._state = _lift_state(graph)
        return graph


def _lift_state(module: GraphModule) -> tuple[GraphModule, list[Tensor]]:
    """Make an argument of each tensor that the graph holds; return graph and tensors, in the arguments' order.

    A parameter and its ``.data`` are two tensors with one memory: they become one argument, so that what one name
    writes the other reads.
    """
    graph = module.graph
    last = next(node for node in reversed(graph.nodes) if node.op == "placeholder")
    without_data = last.meta["val"].fake_mode
    arguments: dict[tuple[object, ...], Node] = {}
    state: list[Tensor] = []
    for node in [node for node in graph.nodes if node.op == "get_attr"]:
        tensor = getattr(module, str(node.target)).detach()
        memory = tensor.data_ptr(), tensor.shape, tensor.stride()
        if memory not in arguments:
            with graph.inserting_after(last):
                arguments[memory] = last = graph.placeholder(f"state_{len(state)}")
            last.meta["val"] = without_data.from_tensor(tensor)
            state.append(tensor)
        node.replace_all_uses_with(arguments[memory])
        graph.erase_node(node)
    return GraphModule(nn.Module(), graph), state


def _compile(graph: GraphModule, arguments: list[Any]) -> Callable[..., Sequence[Tensor]]:
    _choose_cache()
    return torch._inductor.compile(graph, arguments, options={"cpp_wrapper": True})


def _choose_cache() -> None:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rrl"
    os.environ.setdefault(
        "TORCHINDUCTOR_CACHE_DIR", str(cache / "inductor")
    )  # PyTorch's own is in /tmp
