"""The loop's counterpart on the robot: observation in, command out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rrl.deploy.contract import COMMAND, MODEL, Contract, Entry, graph_file, read_contract
from rrl.robot import in_type

Arrays = Mapping[str, NDArray[Any]]
Graph = Callable[[Arrays], Arrays]
"""From inputs to outputs, by the names of the contract."""

RATE_TOLERANCE = 1e-3
"""Of the rate: a clock is no better than that."""


class Policy:
    """An exported policy with its controller, state and safety limits.

    One object drives one robot. The contract and the files are checked when it is made; every
    observation is checked before it is used.

    Args:
        folder: What ``rrl export run=RUN`` wrote.
        rate: Control steps a second of the loop that will call :meth:`act` [Hz].
        graph: Runs the graph; None: ``policy.onnx`` on one core of the processor.

    Attributes:
        contract: What the policy takes and gives.
        reports: What the last step told beside the command: ``base_action``, ``residual``, and one
            flag for each safety limit, ``safety.NAME``.

    Raises:
        FileNotFoundError: If the folder holds no exported policy, or not its graph.
        ValueError: If a file was changed, or the rate is not the one of the training.
    """

    contract: Contract
    reports: dict[str, NDArray[Any]]

    def __init__(
        self, folder: str | Path, rate: float | None = None, graph: Graph | None = None
    ) -> None:
        self.contract = read_contract(folder)
        _check_rate(self.contract.rate, rate)
        self._graph = graph or onnx_graph(graph_file(folder, MODEL))
        self._names = [entry.name for entry in self.contract.entries]
        self.reset()

    def reset(self) -> None:
        """Start an episode: the next observation is its first one."""
        self._state = {f"state/{entry.name}": entry.start() for entry in self.contract.state}
        self._ended = False
        self.reports = {}

    def act(self, observation: Mapping[str, ArrayLike]) -> NDArray[Any]:
        """Take one control step.

        Args:
            observation: The contract's entries in its order, without batch dimensions; others are
                ignored. One number may have no shape, and a name a slash in the place of a dot, as
                :class:`rrl.robot.Observation` has them.

        Returns:
            The command.

        Raises:
            ValueError: If entries are missing, in another order, of another shape or type, or not
                finite where nothing in the chain deals with that.
            RuntimeError: If the episode has ended with a command that was not finite, or the
                command is not finite. The state stays as it was.
        """
        if self._ended:
            raise RuntimeError(
                "act: expected reset() after a command that was not finite has ended the episode"
            )
        outputs = self._graph({**self._checked(observation), **self._state})
        command = outputs[COMMAND]
        if not np.isfinite(command).all():
            raise RuntimeError(f"command: expected finite numbers, got {command.tolist()}")
        self._state = {f"state/{e.name}": outputs[f"next/{e.name}"] for e in self.contract.state}
        self.reports = {e.name: outputs[f"report/{e.name}"] for e in self.contract.reports}
        flag = self.contract.ends_episode
        self._ended = flag is not None and bool(self.reports[flag].any())
        return command

    def _checked(self, observation: Mapping[str, ArrayLike]) -> dict[str, NDArray[Any]]:
        if not isinstance(observation, Mapping):
            raise ValueError(
                f"observation: expected a mapping with {self._names}, "
                f"got a {type(observation).__name__}"
            )
        given = {str(name).replace("/", "."): value for name, value in observation.items()}
        expected = {entry.name.replace("/", "."): entry for entry in self.contract.entries}
        present = [name for name in given if name in expected]
        if present != list(expected):
            missing = [entry.name for name, entry in expected.items() if name not in given]
            got = f"without {missing}" if missing else f"in the order {present}"
            raise ValueError(f"observation: expected the entries {self._names}, got them {got}")
        return {f"entry/{e.name}": _array(e, given[name]) for name, e in expected.items()}


def onnx_graph(path: Path) -> Graph:
    """Load a graph into onnxruntime: one thread that does not spin.

    Raises:
        ImportError: If onnxruntime is not installed.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise ImportError("onnxruntime is not installed: pip install onnxruntime") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    return lambda inputs: dict(zip(names, session.run(names, inputs), strict=True))


def _array(entry: Entry, value: ArrayLike) -> NDArray[Any]:
    array = np.asarray(value)
    if array.ndim == 0 and entry.shape == (1,):
        array = array.reshape(1)
    if array.shape != entry.shape:
        raise ValueError(f"{entry.name}: expected the shape {entry.shape}, got {array.shape}")
    cast = in_type(entry.name, array, entry.dtype)
    if not entry.guarded and not np.isfinite(cast).all():
        raise ValueError(f"{entry.name}: expected finite numbers, got {array.tolist()}")
    return cast


def _check_rate(expected: float | None, rate: float | None) -> None:
    if expected is None:
        return
    if not isinstance(rate, Real) or not abs(rate / expected - 1) <= RATE_TOLERANCE:
        raise ValueError(
            f"rate: expected {expected:g} control steps a second, as in training, got {rate!r}"
        )
