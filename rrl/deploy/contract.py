"""What an exported policy takes, gives and was made from: ``contract.json``.

Layout of the folder::

    contract.json   sealed, see :mod:`rrl.sealed`
    policy.onnx     the graph for onnxruntime
    policy.pt2      the same graph for torch.export.load

Inputs of either graph are the entries, then the state; outputs the command, the reports and the
state for the next step, each in the contract's order. In ``policy.onnx`` they have the names that
:attr:`Contract.inputs` and :attr:`Contract.outputs` give.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sealed import fingerprint, unsealed

FORMAT = 1
CONTRACT, MODEL, ARCHIVE = "contract.json", "policy.onnx", "policy.pt2"
COMMAND = "command"


@dataclass(frozen=True)
class Entry:
    """One array that goes into the graph or comes out of it.

    Attributes:
        name: Its name.
        shape: Its shape; there are no batch dimensions.
        dtype: NumPy's name of its type.
        unit: What its numbers are counted in; empty: unknown.
        guarded: Of an observation: whether the graph itself deals with NaN and infinity in it.
        initial: Of a state: its value at the start of an episode, flat.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    unit: str = ""
    guarded: bool = False
    initial: tuple[Any, ...] = ()

    def start(self) -> NDArray[Any]:
        """Return the initial value."""
        return np.array(self.initial, dtype=self.dtype).reshape(self.shape)


@dataclass(frozen=True)
class Contract:
    """What an exported policy takes and gives.

    Attributes:
        entries: What the robot shows, in the graph's order.
        command: What the robot is told.
        reports: What else the graph tells: base action, residual, safety limits that spoke.
        state: What is handed from a step to the next one.
        rate: Control steps a second that the policy was trained at; None: unknown.
        ends_episode: The report that ends the episode when it is true; None: none does.
        content: All that the file holds.
    """

    entries: tuple[Entry, ...]
    command: Entry
    reports: tuple[Entry, ...]
    state: tuple[Entry, ...]
    rate: float | None
    ends_episode: str | None
    content: Mapping[str, Any]

    @property
    def inputs(self) -> list[str]:
        """The graph's inputs in their order."""
        return graph_inputs(*([e.name for e in group] for group in (self.entries, self.state)))

    @property
    def outputs(self) -> list[str]:
        """The graph's outputs in their order."""
        return graph_outputs(*([e.name for e in group] for group in (self.reports, self.state)))


def graph_inputs(entries: Sequence[str], state: Sequence[str]) -> list[str]:
    """Return the names of a graph's inputs."""
    return [*(f"entry/{name}" for name in entries), *(f"state/{name}" for name in state)]


def graph_outputs(reports: Sequence[str], state: Sequence[str]) -> list[str]:
    """Return the names of a graph's outputs."""
    return [COMMAND, *(f"report/{name}" for name in reports), *(f"next/{name}" for name in state)]


def read_contract(folder: str | Path) -> Contract:
    """Read a folder's contract and compare every file with its checksum.

    Raises:
        FileNotFoundError: If there is no contract.
        ValueError: If a file was changed, or is of another format.
    """
    path = Path(folder) / CONTRACT
    if not path.is_file():
        raise FileNotFoundError(
            f"folder: expected what `rrl export run=RUN` wrote, got {str(folder)!r}: "
            f"no {CONTRACT} there"
        )
    content = _content(path)
    for name, expected in content["files"].items():
        file = path.with_name(name)
        if file.is_file() and fingerprint(file) != expected:
            raise ValueError(
                f"{file}: expected the file that was exported, got a changed one (SHA-256 "
                "differs); export the run again"
            )
    return Contract(
        entries=tuple(map(_entry, content["entries"])),
        command=_entry(content["command"]),
        reports=tuple(map(_entry, content["reports"])),
        state=tuple(map(_entry, content["state"])),
        rate=None if content["control_period"] is None else 1.0 / content["control_period"],
        ends_episode=content["ends_episode"],
        content=content,
    )


def graph_file(folder: str | Path, name: str) -> Path:
    """Return the path of one of the graphs.

    Raises:
        FileNotFoundError: If it is not there.
    """
    path = Path(folder) / name
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: expected the graph that belongs to {CONTRACT}, got none; copy the whole "
            "folder that was exported"
        )
    return path


def _content(path: Path) -> dict[str, Any]:
    try:
        content = unsealed(path.read_bytes())
    except ValueError as error:
        raise ValueError(
            f"{path}: expected the contract that was exported, got a file that is {error}; "
            "export the run again"
        ) from error
    if content["format"] != FORMAT:
        raise ValueError(f"{path}: expected format {FORMAT}, got {content['format']!r}")
    return content


def _entry(node: Mapping[str, Any]) -> Entry:
    return Entry(
        node["name"],
        tuple(node["shape"]),
        node["dtype"],
        node.get("unit") or "",
        bool(node.get("guarded")),
        tuple(node.get("initial", ())),
    )
