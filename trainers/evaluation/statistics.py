"""Intervals and tests for what evaluations count; a run is a cluster of episodes.

``benchmarks/coverage.py`` simulates how often the intervals cover what they say.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import gammaln

Interval = tuple[float, float]
Values: TypeAlias = "Sequence[float] | NDArray[Any]"

NO_INTERVAL = (float("nan"), float("nan"))
"""What one run says about others, and values that are all alike where they have no bounds."""

CONFIDENCE = 0.95
"""Probability with which the intervals cover."""
_MEAN_PRIOR = 0.75
"""Of the mean rate: Beta(0.75, 0.75), between Jeffreys' prior and the uniform one."""
_SPREAD_PRIOR = 0.2
"""Of the root of the correlation within a run: half-Cauchy with this scale (Gelman, 2006)."""
_MEANS, _SPREADS = 400, 40
_ROUNDING = 1e-9
"""Share of the largest value by which equal ones may seem to differ."""


def wilson(successes: int, trials: int) -> Interval:
    """Return Wilson's score interval of the success rate of one policy."""
    interval = stats.binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return float(interval.low), float(interval.high)


def success_interval(solved: Values) -> Interval:
    """Return an interval of the mean success rate of runs like these, on episodes like these.

    The successes of a run are beta-binomial: runs differ, and episodes of one run are alike. The
    interval holds the middle of the mean's posterior under weak priors, integrated over the
    spread between runs, so it stays honest for few runs and near 0 and 1 and never has zero width.
    All runs play the same frozen episodes. Where an episode is hard for all of them, runs say less
    than as many episodes of their own would: they count as so many (Kish, 1965) that the rates of
    episodes scatter as they do. One run says nothing about others; its interval is Wilson's, and
    is of that policy alone.

    Args:
        solved: Whether each run solves each episode, ``[S, N]``.
    """
    table = np.atleast_2d(np.asarray(solved, dtype=float))
    shared = _design_effect(table)
    return rate_interval(table.sum(axis=1) / shared, table.shape[1] / shared)


def _design_effect(table: NDArray[Any]) -> float:
    """By how much episodes that runs share widen the variance: 1, if by nothing, to ``S``.

    Half an episode that all solve, and half a one that none does, are added: of a table without a
    failure nobody can say whose luck it was.
    """
    runs, rates = len(table), table.mean(axis=0)
    rates, weights = np.append(rates, [0.0, 1.0]), np.append(np.ones(len(rates)), [0.5, 0.5])
    mean = np.average(rates, weights=weights)
    variance = (weights * (rates - mean) ** 2).sum() / (weights.sum() - 1)
    return float(np.clip(runs * variance / (mean * (1 - mean)), 1, runs))


def rate_interval(successes: Values, episodes: float) -> Interval:
    """Return the interval of :func:`success_interval` if no episode is harder than another.

    On the very episodes that all runs play it is one of runs like these.

    Args:
        successes: Solved episodes of each run, ``[S]``.
        episodes: Episodes of each run.

    Raises:
        ValueError: If a count is not between 0 and ``episodes``, or there is none.
    """
    counts = tuple(sorted(float(count) for count in successes))
    if not counts or not 0 <= counts[0] <= counts[-1] <= episodes:
        raise ValueError(f"successes: expected counts from 0 to {episodes}, got {counts}")
    if len(counts) == 1:
        return wilson(round(counts[0]), round(episodes))
    return _beta_binomial(counts, float(episodes))


@lru_cache(maxsize=4096)
def _beta_binomial(counts: tuple[float, ...], episodes: float) -> Interval:
    # Means are equally spaced in the arcsine's scale, where Jeffreys' prior is flat.
    mean = np.sin(np.pi / 2 * (np.arange(_MEANS) + 0.5) / _MEANS)[:, None] ** 2  # (M, 1)
    root = (np.arange(_SPREADS) + 0.5) / _SPREADS  # (R,), of the correlation within a run
    size = 1 / root**2 - 1
    a, b = mean * size, (1 - mean) * size  # (M, R), of the beta distribution over runs
    log_density = (_MEAN_PRIOR - 0.5) * np.log(mean * (1 - mean))
    log_density = log_density - np.log1p((root / _SPREAD_PRIOR) ** 2)
    constant = gammaln(a + b) - gammaln(a) - gammaln(b) - gammaln(episodes + a + b)
    log_density = log_density + len(counts) * constant
    for count, runs in zip(*np.unique(counts, return_counts=True), strict=True):
        log_density += runs * (gammaln(count + a) + gammaln(episodes - count + b))
    density = np.exp(log_density - log_density.max()).sum(axis=1)  # (M,)
    cumulative = np.concatenate([[0.0], density.cumsum() / density.sum()])
    edges = np.sin(np.pi / 2 * np.arange(_MEANS + 1) / _MEANS) ** 2
    tail = (1 - CONFIDENCE) / 2
    low, high = np.interp([tail, 1 - tail], cumulative, edges)
    # Nothing speaks against the bound that all counts lie at (Brown, Cai and DasGupta, 2001).
    return (
        0.0 if max(counts) == 0 else float(low),
        1.0 if min(counts) == episodes else float(high),
    )


def mean_interval(values: Values) -> Interval:
    """Return Student's t interval of the mean over runs; not a number if none of them differ."""
    array = np.asarray(values, dtype=float)
    if len(array) < 2:
        return NO_INTERVAL
    half = float(stats.sem(array) * stats.t.ppf(0.5 + CONFIDENCE / 2, len(array) - 1))
    return _with_width(float(array.mean()) - half, float(array.mean()) + half, array)


def _with_width(low: float, high: float, *values: Values) -> Interval:
    """The interval of values, but none that is a point, which would say that it is certain."""
    largest = max(float(np.abs(array).max()) for array in values)
    return (low, high) if high - low > _ROUNDING * largest else NO_INTERVAL


def paired_interval(*differences: Values, bound: float | None = None) -> Interval:
    """Return an interval of the mean difference of two arms on the same episodes.

    The squared errors over runs and over episodes are added, with Satterthwaite's degrees of
    freedom. Differences with a bound, as of successes, get one more episode at either bound
    (Bonett and Price, 2012). Without one, there is no interval where all are alike.

    Args:
        differences: One arm less the other for every run and episode, ``[S, N]``; several are of
            fixed tasks, and the interval is of the mean of the tasks.
        bound: The largest possible difference; 1 for successes.
    """
    tables = [np.atleast_2d(np.asarray(table, dtype=float)) for table in differences]
    if bound is not None:
        tables = [np.pad(table, ((0, 0), (0, 2)), constant_values=bound) for table in tables]
        for table in tables:
            table[:, -1] = -bound
    errors = [_paired_errors(table) for table in tables]
    if not all(errors):
        return NO_INTERVAL
    parts = [(part / len(tables) ** 2, freedom) for error in errors for part, freedom in error]
    difference = float(np.mean([table.mean() for table in tables]))
    return _satterthwaite(difference, parts, bound, tables)


def _paired_errors(table: NDArray[Any]) -> list[tuple[float, int]]:
    """Squared errors of the mean over episodes and over runs, with their freedoms."""
    ways = [(table.mean(axis=way), count - 1) for way, count in enumerate(table.shape[::-1])]
    return [(m.var(ddof=1) / len(m), freedom) for m, freedom in ways if freedom]


def unpaired_interval(values: Values, others: Values, bound: float | None = None) -> Interval:
    """Return an interval of the difference in means of two arms on episodes of their own.

    Welch's interval. Runs of the first arm may differ: its error is that of their means where that
    is larger than the one of all its episodes together. The second arm is the same in all runs.
    With a bound each arm gets one more episode at either end (Agresti and Caffo, 2000). Without
    one, there is no interval where all values of each are alike.

    Args:
        values: The first arm's, for every run and episode, ``[S, N]``.
        others: The second arm's, ``[S, M]``.
        bound: The largest possible value, where the least is 0; 1 for successes.
    """
    runs = np.atleast_2d(np.asarray(values, dtype=float))
    ends = [] if bound is None else [0.0, bound]
    arms = [np.append(arm, ends) for arm in (runs, np.asarray(others, dtype=float))]
    if min(map(len, arms)) < 2:
        return NO_INTERVAL
    parts = [(arm.var(ddof=1) / len(arm), len(arm) - 1) for arm in arms]
    if len(runs) > 1:
        between = runs.mean(axis=1).var(ddof=1) / len(runs), len(runs) - 1
        parts[0] = max(parts[0], between)
    difference = float(arms[0].mean() - arms[1].mean())
    return _satterthwaite(difference, parts, bound, arms)


def _satterthwaite(
    difference: float,
    errors: Sequence[tuple[float, int]],
    bound: float | None,
    values: Sequence[Values],
) -> Interval:
    """Student's t interval of a difference whose squared errors, with their freedoms, add up."""
    error = sum(part for part, _ in errors)
    weights = sum(part**2 / freedom for part, freedom in errors)
    freedom = error**2 / weights if weights else 1.0
    half = float(np.sqrt(error) * stats.t.ppf(0.5 + CONFIDENCE / 2, freedom))
    low, high = _with_width(difference - half, difference + half, *values)
    return (low, high) if bound is None else (max(low, -bound), min(high, bound))


def iqm(*strata: Values) -> float:
    """Return the interquartile mean of all values: the mean of the middle half.

    A quarter is rounded down to whole values: of up to three values it is their mean.
    """
    return float(stats.trim_mean(np.concatenate(strata), 0.25))


def iqm_interval(*strata: Values) -> Interval:
    """Return the stratified percentile bootstrap of :func:`iqm`.

    Runs are drawn anew within each stratum (task or setting). Not a number if a stratum has a
    single run or a value that is none, or if nearly all values are alike.
    """
    arrays = [np.asarray(values, dtype=float) for values in strata]
    if any(len(values) < 2 or not np.isfinite(values).all() for values in arrays):
        return NO_INTERVAL

    def statistic(*samples: np.ndarray, axis: int) -> np.ndarray:
        return np.asarray(stats.trim_mean(np.concatenate(samples, axis), 0.25, axis))

    interval = stats.bootstrap(
        arrays,
        statistic,
        n_resamples=2000,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    return _with_width(float(interval.low), float(interval.high), *arrays)


def mcnemar(rescues: int, regressions: int) -> float:
    """Return the exact two-sided p-value that paired outcomes differ only by chance.

    Args:
        rescues: Episodes that the controller fails and the residual solves.
        regressions: Episodes that the controller solves and the residual fails.
    """
    changed = rescues + regressions
    return float(stats.binomtest(rescues, changed, 0.5).pvalue) if changed else 1.0


def fisher(solved: int, others: int, episodes: int) -> float:
    """Return the exact two-sided p-value that two success counts differ only by chance.

    Args:
        solved: Successes of one arm.
        others: Successes of the other.
        episodes: Episodes of each, independent of one another.
    """
    table = [[solved, episodes - solved], [others, episodes - others]]
    return float(stats.fisher_exact(table).pvalue)
