"""Compiling an update: losses, gradients, optimizers and targets in one graph."""

from __future__ import annotations

import contextlib
import copy
import functools
import importlib
import inspect
import logging
import os
import pkgutil
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.fx import Graph, GraphModule, Node

from rrl.algorithms.products import multiply_in_bfloat16

log = logging.getLogger(__name__)

Update = Callable[..., dict[str, Tensor]]
"""From tensors to metrics; changes tensors that it holds on to (parameters, moments) in place."""

TESTED = "2.13"
"""The version of PyTorch whose private interfaces these are."""
MAKE_FX = "torch.fx.experimental.proxy_tensor:make_fx"
COMPILE = "torch._inductor:compile"
CPP_COMPILER = "torch._inductor.cpp_builder:get_cpp_compiler"
INTERFACES = {
    MAKE_FX: {"tracing_mode", "_allow_non_fake_inputs"},
    COMPILE: {"options"},
    CPP_COMPILER: set[str](),
    "torch._inductor.config:cpp_wrapper": set[str](),
    "torch._subclasses.fake_tensor:FakeTensorMode.from_tensor": set[str](),
}
"""What is used of the compiler, and the arguments that it is called with."""
DRAWS = (
    *("rand.default", "rand_like.default", "randn.default", "randn_like.default"),
    *("normal_.default", "normal_functional.default", "uniform_.default"),
    *("bernoulli_.float", "bernoulli.p"),
)
"""Random operations of ATen that read nothing but shape and type."""

_traced = ContextVar("_traced", default=False)


def compiler_problem() -> str | None:
    """Return why nothing can be compiled here, and what to do; None if it can."""
    _choose_cache()
    try:
        for name, arguments in INTERFACES.items():
            found = pkgutil.resolve_name(name)
            if arguments and not arguments <= inspect.signature(found).parameters.keys():
                raise TypeError(f"{name} without {' or '.join(sorted(arguments))}")
        attrgetter(*DRAWS)(torch.ops.aten)
    except Exception as error:  # whatever a new version comes up with
        return (
            f"PyTorch {torch.__version__} has other compiler interfaces than {TESTED}, which is "
            f"tested ({_first_line(error)}); install that one"
        )
    try:
        pkgutil.resolve_name(CPP_COMPILER)()
    except Exception as error:  # of an internal kind that moves between versions
        return f"no C++ compiler ({_first_line(error)}); install g++"
    return None


def _first_line(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error).strip()}".partition("\n")[0]


def import_compiler() -> None:
    """Import the compiler, which takes two seconds, while something else is awaited anyway."""
    with warnings.catch_warnings(), contextlib.suppress(ImportError, AttributeError):
        warnings.simplefilter("ignore", DeprecationWarning)  # PyTorch's modules warn of one another
        if compiler_problem() is None:
            for module in ("torch._inductor.compile_fx", "torch._dynamo.repro.after_dynamo"):
                importlib.import_module(module)
            find_vector_instructions()


@functools.cache
def find_vector_instructions() -> threading.Thread:
    """Return a thread in which the compiler finds out what the processor and ``g++`` can do.

    It builds and loads small programs for that, in other processes: seconds, of which the first
    update need not wait for one if the thread starts when the learner is made.
    """
    with contextlib.suppress(ImportError):  # another version has other modules
        for module in ("codecache", "cpu_vec_isa"):  # not in the thread: another may import too
            importlib.import_module(f"torch._inductor.{module}")

    def find() -> None:
        with contextlib.suppress(Exception):  # the compiler meets it again, and says so
            importlib.import_module("torch._inductor.cpu_vec_isa").pick_vec_isa()

    thread = threading.Thread(target=find, name="rrl-vector-instructions", daemon=True)
    thread.start()
    return thread


def being_traced() -> bool:
    """Return whether the running code is recorded for a :class:`CompiledUpdate`."""
    return _traced.get()


class CompiledUpdate:
    """An update as one compiled graph, made at the first call; eager where that fails.

    The update is run once on tensors without data, which records what its losses, gradients and
    optimizers do as a list of operations (:func:`torch.fx.experimental.proxy_tensor.make_fx`).
    Python that an update runs each time, a TensorDict's and TorchRL's, leaves no trace in it, which
    is why this is faster than to have :func:`torch.compile` follow the same code;
    ``torch._inductor.compile``, its back half, takes the recorded graph. Tensors that the update
    holds on to become arguments of the graph, which changes them in place. So do its random
    numbers: they are drawn before each call, in the order in which the eager update draws them.

    Args:
        update: Takes tensors whose shapes never change, does the same operations every time, and
            holds on to the same tensors for good.
        module: Owns the tensors that the update changes; they must be in its ``state_dict``.
        bfloat16: Multiply matrices in bfloat16 (:mod:`.products`).
    """

    def __init__(self, update: Update, module: nn.Module, bfloat16: bool = False) -> None:
        self._update, self._module, self._bfloat16 = update, module, bfloat16
        self._names: list[str] = []
        self._state: list[Tensor] = []
        self._draws: list[Callable[[], Tensor]] = []
        self._run: Callable[..., Sequence[Tensor]] | None = None
        self.compile_seconds = 0.0
        self.failed = False

    def __call__(self, *tensors: Tensor) -> dict[str, Tensor]:
        """Do what the update does."""
        if self._run is None and not self.failed:
            with torch.random.fork_rng(devices=range(torch.cuda.device_count())):
                self._try_to_compile(tensors)
        if self._run is None:
            return self._update(*tensors)
        with torch.no_grad():
            values = self._run(*self._arguments(tensors))
        return dict(zip(self._names, values, strict=True))

    def _arguments(self, tensors: tuple[Tensor, ...]) -> list[Tensor]:
        return [*tensors, *self._state, *(draw() for draw in self._draws)]

    def _try_to_compile(self, tensors: tuple[Tensor, ...]) -> None:
        log.info("compiling the update: up to half a minute the first time, else seconds")
        start = time.perf_counter()
        cache = _choose_cache()
        find_vector_instructions().join()
        before = copy.deepcopy(self._module.state_dict())

        def put_back() -> None:
            self._module.load_state_dict(copy.deepcopy(before))  # some keep what they are given

        self._update(*tensors)  # what is made at first use is then made of real tensors
        put_back()
        try:
            with warnings.catch_warnings(), torch.no_grad(), _torn_entries() as torn:
                warnings.simplefilter("ignore")  # of the libraries' code
                graph = self._trace(tensors)
                put_back()  # what involves no tensor of the batch is not only recorded but done
                arguments = self._arguments(tensors)
                compile_graph = pkgutil.resolve_name(COMPILE)
                run = compile_graph(graph, arguments, options={"cpp_wrapper": True})
                run(*arguments)  # a damaged cache shows itself here
            self._run = run
            if torn:
                log.warning("the compiler's cache is damaged, compiled anew; remove %s", cache)
        except Exception as error:  # whatever a compiler, its cache or a new version come up with
            self.failed = True
            warnings.warn(
                "the update is not compiled and takes two to three times as long: "
                f"{_first_line(error)} (PyTorch {torch.__version__}; {TESTED} is tested); "
                f"if the compiler's cache is damaged, remove {cache}",
                stacklevel=4,
            )
        put_back()
        self.compile_seconds = time.perf_counter() - start

    def _trace(self, tensors: tuple[Tensor, ...]) -> GraphModule:
        def values(*arguments: Tensor) -> list[Tensor]:
            with torch.enable_grad():
                metrics = self._update(*arguments)
            self._names = list(metrics)
            return list(metrics.values())

        make_fx, before = pkgutil.resolve_name(MAKE_FX), _traced.set(True)
        try:
            graph = make_fx(values, tracing_mode="fake", _allow_non_fake_inputs=True)(*tensors)
        finally:
            _traced.reset(before)
        self._state = _lift_state(graph)
        self._draws = _lift_draws(graph)
        if self._bfloat16:
            multiply_in_bfloat16(graph.graph)
        return GraphModule(nn.Module(), graph.graph)


def _last_argument(graph: Graph) -> Node:
    return next(node for node in reversed(graph.nodes) if node.op == "placeholder")


def _lift_state(module: GraphModule) -> list[Tensor]:
    """Make an argument of each tensor that the graph holds; return the tensors, in order.

    A parameter and its ``.data`` are two tensors with one memory: they become one argument, so that
    what one name writes the other reads.
    """
    graph = module.graph
    last = _last_argument(graph)
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
    return state


def _lift_draws(module: GraphModule) -> list[Callable[[], Tensor]]:
    """Make an argument of each random tensor; return what draws them, in order.

    The compiler may change the order of draws that do not depend on one another.
    """
    graph = module.graph
    draws: list[Callable[[], Tensor]] = []
    operations = attrgetter(*DRAWS)(torch.ops.aten)
    for node in [node for node in graph.nodes if node.target in operations]:
        with graph.inserting_after(_last_argument(graph)):
            argument = graph.placeholder(f"random_{len(draws)}")
        argument.meta["val"] = node.meta["val"]
        draws.append(_draw(node))
        node.replace_all_uses_with(argument)
        graph.erase_node(node)
    return draws


def _draw(node: Node) -> Callable[[], Tensor]:
    """Return what does a random operation, whose tensors lend nothing but shape and type."""
    draw = cast(Callable[..., Tensor], node.target)
    kwargs = {k: v for k, v in node.kwargs.items() if k != "pin_memory"}

    def template(argument: Any) -> Any:
        if not isinstance(argument, Node):
            return argument
        like = argument.meta["val"]
        return torch.empty(like.shape, dtype=like.dtype, device=like.device)

    return partial(draw, *map(template, node.args), **kwargs)


@contextlib.contextmanager
def _torn_entries() -> Iterator[list[logging.LogRecord]]:
    """Collect what PyTorch says, with a traceback each, of entries that it cannot read."""
    torn: list[logging.LogRecord] = []

    def is_other(record: logging.LogRecord) -> bool:
        if "unable to load compiled graph" not in record.getMessage():
            return True
        torn.append(record)
        return False

    library = logging.getLogger("torch._inductor.codecache")
    library.addFilter(is_other)
    try:
        yield torn
    finally:
        library.removeFilter(is_other)


def _choose_cache() -> str:
    cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))  # noqa: PTH111
    if not cache.is_absolute():  # a user without a home, as in a container; Path's would raise
        cache = Path(tempfile.gettempdir()) / f"cache-{os.getuid()}"
    # PyTorch's own is in /tmp, by the user's name
    return os.environ.setdefault("TORCHINDUCTOR_CACHE_DIR", str(cache / "rrl" / "inductor"))
