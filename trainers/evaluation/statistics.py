"""Intervals and tests for what an evaluation counts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Interval = tuple[float, float]
Values: TypeAlias = "Sequence[float] | NDArray[Any]"


def wilson(successes: int, trials: int, confidence: float = 0.95) -> Interval:
    """Wilson's score interval of a success rate."""
    interval = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def mean_interval(values: Values, confidence: float = 0.95) -> Interval:
    """Student's t interval of the mean over independent runs; degenerate for a single one."""
    array = np.asarray(values, dtype=float)
    mean = float(array.mean())
    if len(array) < 2 or np.ptp(array) == 0:
        return mean, mean
    half = stats.sem(array) * stats.t.ppf(0.5 + confidence / 2, len(array) - 1)
    return mean - float(half), mean + float(half)


def exact_interval(successes: int, trials: int, confidence: float = 0.95) -> Interval:
    """Clopper and Pearson's interval of a success rate: never too narrow."""
    interval = stats.binomtest(successes, trials).proportion_ci(confidence, method="exact")
    return float(interval.low), float(interval.high)


def iqm(*strata: Values) -> float:
    """Interquartile mean of all values: the mean of the middle half."""
    return float(stats.trim_mean(np.concatenate(strata), 0.25))


def iqm_interval(*strata: Values, confidence: float = 0.95, resamples: int = 2000) -> Interval:
    """Stratified percentile bootstrap of :func:`iqm`: seeds are drawn anew within each stratum (task or setting)."""
    arrays = [np.asarray(values, dtype=float) for values in strata]
    if any(len(values) < 2 for values in arrays) or np.ptp(np.concatenate(arrays)) == 0:
        return iqm(*arrays), iqm(*arrays)

    def statistic(*samples: np.ndarray, axis: int) -> np.ndarray:
        return np.asarray(stats.trim_mean(np.concatenate(samples, axis), 0.25, axis))

    interval = stats.bootstrap(
        arrays,
        statistic,
        n_resamples=resamples,
        confidence_level=confidence,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return float(interval.low), float(interval.high)


def mcnemar(rescues: int, regressions: int) -> float:
    """Exact two-sided p-value that paired successes and failures differ only by chance.

    Args:
        rescues: episodes that the controller fails and the residual solves.
        regressions: episodes that the controller solves and the residual fails.

    """
    changed = rescues + regressions
    return float(stats.binomtest(rescues, changed, 0.5).pvalue) if changed else 1.0
