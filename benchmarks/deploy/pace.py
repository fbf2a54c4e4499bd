"""A loop with absolute deadlines, and what a step in it takes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

SPIN = 0.001
"""Seconds before a step is due from which on the loop does not sleep any more."""


@dataclass(frozen=True)
class Pace:
    """What the steps of a loop took.

    Attributes:
        seconds: Of each step.
        missed: Control steps that ended after the next one was due, or were left out because of that.
        steps: How many were due.
    """

    seconds: np.ndarray
    missed: int
    steps: int

    def row(self) -> list[str]:
        """Return p50, p99 and maximum in microseconds, and the missed deadlines."""
        numbers = [*np.percentile(self.seconds, [50, 99]), self.seconds.max()]
        return [*(f"{1e6 * n:.0f}" for n in numbers), f"{self.missed} of {self.steps}"]


def keep_pace(step: Callable[[int], object], rate: float, seconds: float) -> Pace:
    """Call ``step`` with 0, 1, 2 ... at ``rate``; what is late is left out, not made up for."""
    steps, number, missed = round(seconds * rate), 0, 0
    taken = []
    start = time.perf_counter() + 1 / rate
    while number < steps:
        due = start + number / rate
        while (left := due - time.perf_counter()) > 0:
            time.sleep(max(left - SPIN, 0.0))
        began = time.perf_counter()
        step(number)
        ended = time.perf_counter()
        taken.append(ended - began)
        late = int((ended - due) * rate)
        missed += late
        number += 1 + late
    return Pace(np.array(taken), missed, steps)
