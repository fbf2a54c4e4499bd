"""What learner and acting process give each other: files below the run's directory.

Layout::

    realtime/
        recipe.pkl       settings, environment, exploration; written by whoever starts the process
        interface.pkl    what the learner must know of the environment
        policy.pkl       the policy's structure
        weights.bin      its numbers, replaced as a whole
        failure.pkl      what ended the process, if it was an error
        log.txt          what the process says
        pid              of the process
        requests.txt     what a person asks for, one name a line
        transitions/     every transition, in files that only grow
        wish, robot      locked by whoever wants the robot, and whoever has it
        learner/         locked by whoever learns

Either side may die at any moment: a reader finds all of an old file or all of a new one, and locks
end with their process.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle
import torch
from torch import Tensor

from ...requests import Request
from ...storage.files import lock

FOLDER = "realtime"
REQUESTS, MESSAGES, LEARNER = "requests.txt", "log.txt", "learner"


@dataclass(frozen=True)
class Weights:
    """A policy's numbers.

    Attributes:
        env_steps: Environment steps that it has learned from.
        seed: Of the training episodes.
        vector: See :mod:`..policy_vector`.
    """

    env_steps: int
    seed: int
    vector: Tensor


class HandOver:
    """The files.

    Args:
        folder: Where they lie.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._read: tuple[int, int] | None = None
        self._known: dict[str, int] = {}  # bytes by file that were read

    def write(self, name: str, content: Any) -> None:
        """Replace ``name.pkl``."""
        self._replace(f"{name}.pkl", cloudpickle.dumps(content))

    def read(self, name: str) -> Any:
        """Return the content of ``name.pkl``; None if there is none."""
        path = self.folder / f"{name}.pkl"
        return cloudpickle.loads(path.read_bytes()) if path.is_file() else None

    def clear(self) -> None:
        """Remove what an earlier process left, but for its transitions."""
        for name in ("interface.pkl", "policy.pkl", "weights.bin", "failure.pkl", "pid", REQUESTS):
            (self.folder / name).unlink(missing_ok=True)

    def tell(self, request: Request) -> None:
        """Pass on what a person asks for."""
        with (self.folder / REQUESTS).open("a", encoding="ascii") as file:
            file.write(f"{request.name}\n")

    def heard(self) -> list[Request]:
        """Return what a person has asked for since the last call."""
        return [Request[name] for name in self._new_lines(REQUESTS)]

    def said(self) -> list[str]:
        """Return what the process has said since the last call."""
        return self._new_lines(MESSAGES)

    def _new_lines(self, name: str) -> list[str]:
        path, start = self.folder / name, self._known.get(name, 0)
        if not path.is_file() or path.stat().st_size <= start:
            return []
        with path.open("rb") as file:
            file.seek(start)
            text = file.read()
        whole = text[: text.rfind(b"\n") + 1]
        self._known[name] = start + len(whole)
        return whole.decode(errors="replace").splitlines()

    def is_paused(self) -> bool:
        """Return whether a person has asked for a pause that nobody has ended."""
        pauses = {Request.PAUSE, Request.GO_ON}
        asked = [request for request in HandOver(self.folder).heard() if request in pauses]
        return asked[-1:] == [Request.PAUSE]

    def publish(self, weights: Weights) -> None:
        """Replace the weights."""
        header = torch.tensor([weights.env_steps, weights.seed])
        vector = weights.vector.to(torch.float32).contiguous()
        self._replace("weights.bin", header.numpy().tobytes() + vector.numpy().tobytes())

    def has_weights(self) -> bool:
        """Return whether any were published since :meth:`clear`."""
        return (self.folder / "weights.bin").is_file()

    def new_weights(self) -> Weights | None:
        """Return the weights if they were replaced since the last call."""
        try:
            with (self.folder / "weights.bin").open("rb") as file:
                status = os.fstat(file.fileno())
                which = status.st_ino, status.st_mtime_ns
                if which == self._read:
                    return None
                content = bytearray(file.read())
        except FileNotFoundError:
            return None
        self._read = which
        header = torch.frombuffer(content, dtype=torch.int64, count=2)
        vector = torch.frombuffer(content, dtype=torch.float32, offset=16)
        return Weights(int(header[0]), int(header[1]), vector)

    def is_alive(self) -> bool:
        """Return whether a process acts, or is about to."""
        if not self.folder.is_dir():
            return False
        try:
            os.close(lock(self.folder))
        except BlockingIOError:
            return True
        return False

    @contextmanager
    def having_robot(self) -> Iterator[None]:
        """Have the robot to oneself while the body runs: the process ends its episode first."""
        with _locked(self.folder / "wish"), _locked(self.folder / "robot"):
            yield

    def is_wanted(self) -> bool:
        """Return whether somebody waits for the robot."""
        with (self.folder / "wish").open("a+b") as file:  # a shared lock may need a reader
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return True
        return False

    def driving(self) -> AbstractContextManager[None]:
        """Hold the robot while the body runs, as the acting process does for an episode."""
        return _locked(self.folder / "robot")

    def _replace(self, name: str, content: bytes) -> None:
        partial = self.folder / f".{name}.partial"
        partial.write_bytes(content)
        partial.replace(self.folder / name)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with path.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
