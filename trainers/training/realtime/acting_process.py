"""The acting process as its learner has it: started, found, told to end."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from ...errors import unpacked
from ...storage.files import lock
from .hand_over import LEARNER, MESSAGES, HandOver

CLOSE_SECONDS = 10.0
"""How long the process gets to stop the robot before it is ended."""
POLL = 0.01
"""Seconds between two looks."""

log = logging.getLogger(__name__)


class ActingProcess:
    """The process that drives the environment; this one has started it, or an earlier learner.

    Args:
        hand_over: What it is given and gives.

    Raises:
        BlockingIOError: If somebody else learns from it, in this process or another one; it would
            wait for that one's weights.
    """

    def __init__(self, hand_over: HandOver) -> None:
        self._hand_over = hand_over
        self._started: subprocess.Popen[bytes] | None = None
        claim = hand_over.folder / LEARNER
        claim.mkdir(parents=True, exist_ok=True)
        try:
            self._claim: int | None = lock(claim)
        except BlockingIOError:
            raise BlockingIOError(
                f"{hand_over.folder.parent}: expected no other trainer that learns in real time "
                "here, got one, of this or another process; close it first"
            ) from None

    def release(self) -> None:
        """Let somebody else learn from it."""
        if self._claim is not None:
            os.close(self._claim)
        self._claim = None

    @property
    def is_started_here(self) -> bool:
        """Whether this process has started it, and not seen it end by :meth:`end`."""
        return self._started is not None

    def is_found(self) -> bool:
        """Return whether an earlier learner's process acts.

        One that has not begun to, because its learner died before, ends by itself.
        """
        while self._hand_over.is_alive():
            if self._hand_over.has_weights():
                return True
            time.sleep(POLL)
        return False

    def start(self, recipe: Any) -> None:
        """Start it with settings, environment and exploration."""
        self._hand_over.clear()
        self._hand_over.write("recipe", recipe)
        paths = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)
        folder, package = str(self._hand_over.folder), __package__
        with (self._hand_over.folder / MESSAGES).open("ab") as messages:
            self._started = subprocess.Popen(
                [sys.executable, "-m", package, folder, str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=messages,
                stderr=messages,
                start_new_session=True,  # a Ctrl-C in the terminal is for the learner
                # It finds what this process finds; -m alone would put the working directory first.
                env={**os.environ, "PYTHONPATH": paths, "PYTHONSAFEPATH": "1"},
            )
        log.info(
            "process %d drives the environment, and goes on if this one is killed; "
            "kill %d stops it",
            self._started.pid,
            self._started.pid,
        )

    def runs(self) -> bool:
        """Return whether it does."""
        if self._started is not None:
            return self._started.poll() is None
        return self._hand_over.is_alive()

    def require(self) -> None:
        """Raise what ended it, if it has ended.

        Raises:
            RuntimeError: If it has died. What the environment raised is raised here.
        """
        if self.runs():
            return
        if (failure := self._hand_over.read("failure")) is not None:
            raise unpacked(failure, "the acting process")
        raise RuntimeError(
            "the acting process died; every transition is on disk, "
            f"and its last words are in {self._hand_over.folder / MESSAGES}"
        )

    def wait_for(self, name: str) -> Any:
        """Return what it hands over under a name, once it is there."""
        while (content := self._hand_over.read(name)) is None:
            self.require()
            time.sleep(POLL)
        return content

    def ask_to_end(self) -> None:
        """Have it stop the robot and end; nothing is waited for."""
        self._send(signal.SIGTERM)

    def end(self) -> None:
        """Have it stop the robot and end, and see to it that it does."""
        self.ask_to_end()
        ends = time.monotonic() + CLOSE_SECONDS
        while self.runs() and time.monotonic() < ends:
            time.sleep(POLL)
        self._send(signal.SIGKILL)
        if self._started is not None:
            self._started.wait()
        self._started = None

    def _send(self, number: signal.Signals) -> None:
        """Send it a signal, if it runs."""
        if self._started is not None:
            self._started.send_signal(number)
        elif self._hand_over.is_alive():
            os.kill(int((self._hand_over.folder / "pid").read_text()), number)
