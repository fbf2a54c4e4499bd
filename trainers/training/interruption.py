"""Stopping a run from outside: Ctrl-C, SIGTERM, and SIGHUP when the terminal goes away."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

log = logging.getLogger(__name__)

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(Exception):
    """The run was stopped by a signal, after a checkpoint.

    Attributes:
        signal: Which one; a shell expects the exit status ``128 + signal``.
    """

    def __init__(self, number: signal.Signals) -> None:
        super().__init__(f"interrupted by {number.name}")
        self.signal = number


class Interruption:
    """Remembers that somebody asked the run to stop.

    Args:
        answer: What is done about it, said at the first signal.

    Attributes:
        when_asked: Called when somebody asks, so that nothing waits any longer.
        at_once: Called before a second signal ends the process.
    """

    def __init__(self, answer: str = "finishing this round and saving") -> None:
        self.signal: signal.Signals | None = None
        self._answer = answer
        self.when_asked: list[Callable[[], None]] = []
        self.at_once: list[Callable[[], None]] = []

    def ask(self, number: signal.Signals) -> None:
        """Ask the run to stop, as if a signal had come."""
        self.signal = number
        for call in self.when_asked:
            call()
        log.warning("%s: %s; another signal stops at once", number.name, self._answer)

    def check(self) -> None:
        """Raise :class:`Interrupted` if somebody asked.

        Raises:
            Interrupted: If somebody did.
        """
        if self.signal is not None:
            raise Interrupted(self.signal)

    @contextmanager
    def listening(self) -> Iterator[Interruption]:
        """Take note of the signals while the body runs; the second one ends the process at once.

        What was asked of an earlier body is forgotten.

        SIGHUP stays ignored where it is, as below ``nohup``.

        Ending at once loses nothing that a SIGKILL would not lose. Outside of the main thread,
        where Python allows no signal handlers, this does nothing.
        """
        self.signal = None
        if threading.current_thread() is not threading.main_thread():
            yield self
            return
        ignored = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        heard = [number for number in SIGNALS if not (ignored and number == signal.SIGHUP)]
        before = {number: signal.signal(number, self._note) for number in heard}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.signal is not None:
            for call in self.at_once:
                call()
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        self.ask(signal.Signals(number))
