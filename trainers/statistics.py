"""Intervals and tests for what an evaluation counts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

Interval = tuple[float, float]


def wilson(successes: int, trials: int, confidence: float = 0.95) -> Interval:
    """Wilson's score interval of a success rate."""
    interval = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def mean_interval(values: Sequence[float], confidence: float = 0.95) -> Interval:
    """Student's t interval of the mean over independent runs; degenerate for a single one."""
    array = np.asarray(values, dtype=float)
    mean = float(array.mean())
    if len(array) < 2 or np.ptp(array) == 0:
        return mean, mean
    half = stats.sem(array) * stats.t.ppf(0.5 + confidence / 2, len(array) - 1)
    return mean - float(half), mean + float(half)


def mcnemar(rescues: int, regressions: int) -> float:
    """Exact two-sided p-value that paired successes and failures differ only by chance.

    Args:
        rescues: episodes that the controller fails and the residual solves.
        regressions: episodes that the controller solves and the residual fails.

    """
    changed = rescues + regressions
    return float(stats.binomtest(rescues, changed, 0.5).pvalue) if changed else 1.0
