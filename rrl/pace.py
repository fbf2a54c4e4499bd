"""A fixed rate in wall-clock time, without drift and without bursts."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

log = logging.getLogger(__name__)


def _nothing() -> None:
    """Have nothing to do meanwhile."""


class Pace:
    """Begins the periods of a control loop at absolute deadlines.

    Deadline ``n`` is ``start + n * period``, so errors do not add up. Deadlines that have passed
    are given up: a loop that was late goes on with the next one and never catches up in a burst.
    Without torch, so that a robot's own loop can use it::

        pace = Pace(0.05)
        pace.start()
        while True:
            robot.command(policy.act(robot.observe().entries))
            pace.wait()

    Args:
        period: Seconds from one deadline to the next, positive.

    Attributes:
        began: When the current period began, by ``time.monotonic()`` [s].
        error: How much longer than ``period`` the last one took [s]; negative if it was shorter.
        meanwhile: Called by every :meth:`wait` before it sleeps: work for which there is time then.

    Raises:
        ValueError: If the period is not positive.
    """

    def __init__(self, period: float) -> None:
        if not 0.0 < period < float("inf"):
            raise ValueError(f"period: expected a positive number of seconds, got {period!r}")
        self.period = period
        self.meanwhile: Callable[[], None] = _nothing
        self.start()

    def start(self) -> None:
        """Begin the first period now."""
        self.began = self._deadline = time.monotonic()
        self._deadline += self.period
        self.error = 0.0

    @property
    def scheduled(self) -> float:
        """When the current period should have begun, by ``time.monotonic()`` [s]."""
        return self._deadline - self.period

    def wait(self) -> None:
        """Wait for the end of the current period, and begin the next."""
        self.meanwhile()
        if (late := time.monotonic() - self._deadline) >= self.period:
            self._deadline += int(late / self.period) * self.period
        if (remaining := self._deadline - time.monotonic()) > 0:
            time.sleep(remaining)
        now = time.monotonic()
        self.error, self.began = now - self.began - self.period, now
        self._deadline += self.period


def prioritize(priority: int) -> bool:
    """Have all threads of this process, and those that they start, come before ordinary ones.

    Where the system does not allow it, say so and go on: the loop is then as punctual as the other
    processes let it be.

    Args:
        priority: 1 to 99, of Linux's SCHED_FIFO; 0 changes nothing.

    Returns:
        Whether they do now.
    """
    if not priority:
        return False
    try:
        _schedule(os.SCHED_FIFO, priority)
        return True
    except (AttributeError, PermissionError, FileNotFoundError):
        log.warning(
            "priority: this system does not let the process have real-time priority %d; going on "
            "without (on Linux: ulimit -r, or CAP_SYS_NICE)",
            priority,
        )
        return False


@contextmanager
def prioritized(priority: int) -> Iterator[None]:
    """Do :func:`prioritize` while the body runs; threads that it starts are ordinary afterwards."""
    comes_first = prioritize(priority)
    try:
        yield
    finally:
        if comes_first:
            _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> None:
    for thread in Path("/proc/self/task").iterdir():
        with suppress(ProcessLookupError):  # it has ended since it was listed
            os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))
