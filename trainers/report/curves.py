"""From logged metrics to curves over runs, with intervals; whatever draws them."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ..evaluation.statistics import NO_INTERVAL, Interval, mean_interval, rate_interval

T = TypeVar("T")

Floats = NDArray[np.float64]
Series = Mapping[int, Sequence[tuple[int, float]]]
"""Seed to ``(env_steps, value)`` in order."""
ALONE = "controller alone"
ANY = (-math.inf, math.inf)


@dataclass(frozen=True)
class Curve:
    """One metric of runs that differ by the seed.

    Attributes:
        seeds: The runs' seeds ``[S]``.
        steps: Environment steps ``[T]``.
        values: One row per run ``[S, T]``.
        known: Which of the values there are ``[S, T]``; None: all of them.
    """

    seeds: tuple[int, ...]
    steps: Floats
    values: Floats
    known: NDArray[np.bool_] | None = None

    @property
    def columns(self) -> list[Floats]:
        """The values that there are at each step."""
        if self.known is None:
            return list(self.values.T)
        return [column[there] for column, there in zip(self.values.T, self.known.T, strict=True)]

    @property
    def mean(self) -> Floats:
        """Mean over the runs that there are values of ``[T]``."""
        if self.known is None:
            return self.values.mean(0)
        return np.array([column.mean() for column in self.columns])

    def band(
        self, episodes: int | Floats | None = None, bounds: tuple[float, float] = ANY
    ) -> tuple[Floats, Floats] | None:
        """Return the 95 % interval of the mean, two ``[T]``.

        Args:
            episodes: Of each run, where values are shares of them, of all steps or ``[T]``: see
                :func:`~rrl.trainers.evaluation.statistics.rate_interval`. None: Student's t.
            bounds: Values that Student's interval does not leave.

        Returns:
            None where a single run says nothing about others.
        """
        if episodes is not None:
            counts = np.broadcast_to(episodes, self.steps.shape)
            pairs = zip(self.columns, counts, strict=True)
            low, high = np.array([_rate_interval(rates, int(count)) for rates, count in pairs]).T
        elif len(self.values) > 1:
            low, high = np.array([mean_interval(column) for column in self.columns]).T
            low, high = low.clip(*bounds), high.clip(*bounds)
        else:
            return None
        return low, high

    def level(self, end: float) -> Curve:
        """Return a curve up to ``end``, of what does not learn: a single value is a level."""
        if len(self.steps) > 1 or self.steps[0] == end:
            return self
        known = None if self.known is None else np.repeat(self.known, 2, axis=1)
        values = np.repeat(self.values, 2, axis=1)
        return replace(self, steps=np.array([0.0, end]), values=values, known=known)

    def thinned(self, points: int) -> Curve:
        """Return at most about ``points`` points, each the mean of neighbors."""
        every = -(-len(self.steps) // points)
        starts = np.arange(0, len(self.steps), every)
        steps = self.steps[np.append(starts[1:], len(self.steps)) - 1]
        known = np.ones(self.values.shape, dtype=bool) if self.known is None else self.known
        sums = np.add.reduceat(np.where(known, self.values, 0.0), starts, axis=1)
        counts = np.add.reduceat(known, starts, axis=1, dtype=int)
        values = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
        return replace(
            self, steps=steps, values=values, known=None if self.known is None else counts > 0
        )


def curve(series: Series) -> Curve:
    """Return the steps that every run logged; of a step logged twice the last value counts."""
    per_seed = {seed: dict(points) for seed, points in series.items()}
    steps = sorted(set.intersection(*(set(points) for points in per_seed.values())))
    values = np.array([[points[t] for t in steps] for points in per_seed.values()])
    return Curve(tuple(per_seed), np.array(steps, dtype=float), values)


def joined(series: Series) -> Curve:
    """Return every step that any run logged; of a step logged twice the last value counts.

    A run counts at each with its last value so far, from its first one until its next one is
    overdue: until its longest time between two has passed once more.
    """
    steps = np.array(sorted({step for points in series.values() for step, _ in points}), float)
    values, known = [], []
    for points in series.values():
        at, logged = np.array(sorted(dict(points).items()), dtype=float).T
        last = np.searchsorted(at, steps, side="right") - 1
        overdue = at[-1] + np.diff(at).max(initial=0)
        there = (last >= 0) & ((steps < overdue) | (steps <= at[-1]))
        values.append(np.where(there, logged[last], np.nan))
        known.append(there)
    whole = np.all(known)
    return Curve(tuple(series), steps, np.array(values), None if whole else np.array(known))


def counts_at(steps: Floats, logged: Iterable[Sequence[tuple[int, float]]], other: int) -> Floats:
    """Return the episodes of an evaluation ``[T]``, the fewest of any run.

    Args:
        steps: Of the evaluations ``[T]``.
        logged: Of every run ``(env_steps, episodes)``.
        other: What counts where nothing was logged.
    """
    runs = [dict(points) for points in logged]
    return np.array([min(float(points.get(step, other)) for points in runs) for step in steps])


def view(lines: Iterable[Floats], share: float) -> tuple[float, float]:
    """Return limits of an axis that hold all lines, and more by a share of their range."""
    values = np.concatenate([np.zeros(0), *lines])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    room = share * (high - low) or 0.1 * abs(high) or 1.0
    return low - room, high + room


def alike(items: Iterable[T], values: Callable[[T], Hashable]) -> list[list[T]]:
    """Put items together whose values are equal, in the order of their first ones."""
    found: dict[Hashable, list[T]] = {}
    for item in items:
        found.setdefault(values(item), []).append(item)
    return list(found.values())


def controllers(values: Mapping[str, Hashable]) -> dict[str, list[str]]:
    """Tell the controllers alone apart by what they came to.

    Args:
        values: What the controller came to, by the name of what learns on it.

    Returns:
        Every controller's name, and the names of what learns on it. A controller is named after
        these, but for the one that is below most.
    """
    same = alike(values, values.__getitem__)
    of = [f", {', '.join(names)}" if 2 * len(names) <= len(values) else "" for names in same]
    return {ALONE + o: names for o, names in zip(of, same, strict=True)}


def _rate_interval(rates: Floats, episodes: int) -> Interval:
    if not np.isfinite(rates).all():
        return NO_INTERVAL
    return rate_interval(np.rint(rates * episodes), episodes)
