"""The folder that a robot gets: graph, contract, checksums."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.envs import EnvBase

from rrl.deploy.archive import module_graph
from rrl.deploy.contract import ARCHIVE, COMMAND, CONTRACT, FORMAT, MODEL
from rrl.deploy.policy import Arrays, Graph, onnx_graph
from rrl.keys import ACTION, BASE_ACTION
from rrl.sealed import fingerprint, sealed
from rrl.transforms.base import RandomTransform
from rrl.transforms.base.action_bounds import limits_of

from ..descriptions import named, plain
from ..environment import EnvironmentFactory
from ..storage.versions import versions
from .chain import Chain, StaysOutside
from .rehearsal import Rehearsal
from .traced import quiet, trace

TOLERANCE = 1e-4
"""Largest difference from the trainer's commands, in half ranges of the action. Rounding in float32
comes to less, and a graph that is wrong to far more."""
TOOLS = ("onnx", "onnxscript", "onnxruntime")


def export_policy(
    environment: EnvironmentFactory,
    policy: TensorDictModuleBase,
    folder: Path | str,
    about: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write everything between a robot's raw entries and its command into one folder.

    The trainer's own chain is recorded, and the files are rehearsed: they have to give the
    trainer's commands. Simulated faults (disturbances, noise and latency of sensors) are left out.
    A controller that cannot be recorded stays outside, and ``base_action`` is an entry.

    Args:
        environment: The scenario; one of a robot is made too, for its specs: the robot must run.
        policy: From the inputs to the residual.
        folder: Where to write; an earlier export is replaced.
        about: What else the contract says, such as where the policy was trained.

    Returns:
        The contract's content.

    Raises:
        ImportError: If what writes ONNX is not installed.
        FileExistsError: If ``folder`` holds something else.
        ValueError: If the chain cannot be recorded, or a file does not give its commands.
    """
    tools, folder = require_tools(), Path(folder)
    if folder.exists() and not (folder / CONTRACT).is_file():
        raise FileExistsError(f"{folder}: expected no folder or an earlier export, got another one")
    with ExitStack() as stack:
        env = stack.enter_context(closing(environment.make(1)))
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside = TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent)
        stage = Path(stack.enter_context(beside)) / "new"
        stage.mkdir()
        content = _write(env.base_env, environment, policy, stage)
        content |= {"versions": versions() | tools, **plain(about or {})}
        content["files"] = {name: fingerprint(stage / name) for name in (MODEL, ARCHIVE)}
        (stage / CONTRACT).write_text(sealed(content), encoding="utf-8")
        _put_in_place(stage, folder)
    return content


def _put_in_place(stage: Path, folder: Path) -> None:
    """Give ``stage`` the name ``folder``; what had it before stays beside ``stage``."""
    before = folder.rename(stage.with_name("before")) if folder.exists() else None
    try:
        stage.rename(folder)
    except BaseException:
        if before:
            before.rename(folder)
        raise


def _write(
    like: EnvBase, environment: EnvironmentFactory, policy: TensorDictModuleBase, folder: Path
) -> dict[str, Any]:
    """Write both graphs into ``folder`` and return what the contract says about them."""
    why_outside = None
    try:
        content = _attempt(like, environment, Chain(like, environment, policy), policy, folder)
    except StaysOutside as error:
        why_outside = str(error)
    except Exception as error:  # recording fails in any way that a controller's code can
        why_outside = _first_line(error.__cause__ or error)
    if why_outside:
        chain = Chain(like, environment, policy, with_controller=False)
        content = _attempt(like, environment, chain, policy, folder)
    faults = [make for make in environment.sensing if isinstance(make(), RandomTransform)]
    return {
        "format": FORMAT,
        "control_period": environment.control_period or getattr(like, "control_period", None),
        **content,
        "controller": {**named(environment.controller), "why_outside": why_outside},
        "residual_scale": plain(environment.residual_scale),
        "safety": [named(make) for make in environment.safety],
        "left_out": {  # what simulates a fault
            "disturbances": [named(make) for make in environment.disturbances],
            "sensing": [named(make) for make in faults],
        },
    }


def _attempt(
    like: EnvBase,
    environment: EnvironmentFactory,
    chain: Chain,
    policy: TensorDictModuleBase,
    folder: Path,
) -> dict[str, Any]:
    """Record a chain, write both graphs and rehearse them.

    Raises:
        ValueError: If one of that fails; the message says which.
    """
    operations = "transforms and a policy of torch operations that do not branch on numbers"
    with _failing("the chain cannot be exported", operations):
        traced = trace(chain)
    with _failing(f"{MODEL} cannot be written", "operations that ONNX has"):
        traced.save(folder)
    rehearsal = Rehearsal(like, environment, policy, traced)
    with quiet():
        program = torch.export.load(folder / ARCHIVE)
    with _failing(f"{MODEL} cannot be loaded", "what onnxruntime takes"):
        model = onnx_graph(folder / MODEL)
    module = module_graph(program.module(), traced.inputs, traced.outputs)
    graphs = {MODEL: _running(MODEL, model), ARCHIVE: _running(ARCHIVE, module)}
    differences = {name: rehearsal.difference(graph) for name, graph in graphs.items()}
    for name, difference in differences.items():
        if difference > TOLERANCE:
            raise ValueError(
                f"{name}: expected the trainer's commands to {TOLERANCE:g} half ranges of the "
                f"action, got a difference of {difference:g}; a part of the chain keeps a memory "
                "that it does not declare"
            )
    guarded = {
        name
        for name in traced.entries
        if chain.guard and rehearsal.deals_with_nan(name, graphs[MODEL], TOLERANCE)
    }
    units, action = environment.units, like.full_action_spec[ACTION]
    return {
        "entries": [
            _array(name, value, units.get(name), guarded=name in guarded)
            for name, value in traced.entries.items()
        ],
        "command": _array(COMMAND, traced.command, units.get(ACTION), **_bounds(action)),
        "reports": [
            _array(name, value, units.get(ACTION) if name == BASE_ACTION else None)
            for name, value in traced.reports.items()
        ],
        "state": [
            _array(name, value, initial=value.flatten().tolist())
            for name, value in traced.state.items()
        ],
        "ends_episode": chain.guard if chain.guard_ends_episode else None,
        "rehearsal": {"steps": rehearsal.steps, "largest_difference": differences},
    }


def _array(name: str, value: Tensor, unit: str | None = None, **more: Any) -> dict[str, Any]:
    """Describe an array that goes into the graph or comes out of it."""
    node = {"name": name, "shape": list(value.shape), "dtype": str(value.dtype).split(".")[-1]}
    return {**node, **({"unit": unit} if unit else {}), **more}


def _bounds(action: TensorSpec) -> dict[str, Any]:
    """Describe an action's bounds, one number for each dimension; null: there is none."""
    limits = limits_of(action)
    return {side: plain(getattr(limits, side).flatten().tolist()) for side in ("low", "high")}


@contextmanager
def _failing(what: str, expected: str) -> Iterator[None]:
    """Say what has failed."""
    try:
        yield
    except Exception as error:  # exporters and runtimes have errors of many kinds
        raise ValueError(f"{what}: expected {expected}, got {_first_line(error)}") from error


def _running(name: str, graph: Graph) -> Graph:
    """Return a graph that says which one it is when it fails."""

    def run(values: Arrays) -> Arrays:
        with _failing(f"{name} does not run", "a step with the entries and the state"):
            return graph(values)

    return run


def _first_line(error: BaseException) -> str:
    text = str(error).strip().partition("\n")[0]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def require_tools() -> dict[str, str]:
    """Return the versions of what writes and runs ONNX.

    Raises:
        ImportError: If something is not installed.
    """
    try:
        return {name: import_module(name).__version__ for name in TOOLS}
    except ImportError as error:
        raise ImportError(
            f"expected {', '.join(TOOLS)}, got no {error.name}: "
            "pip install -e '.[export]' in the clone"
        ) from error
