"""From logged metrics to curves with confidence bands, whatever draws them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Floats = NDArray[np.float64]
Series = Mapping[int, Sequence[tuple[int, float]]]
"""Seed to ``(env_steps, value)`` in order, as ``read_metrics`` gives it."""


@dataclass(frozen=True)
class Curve:
    """One metric of one run.

    Attributes:
        seeds: the run's seeds ``[S]``.
        steps: environment steps of one seed ``[T]``.
        values: one row per seed ``[S, T]``.
    """

    seeds: tuple[int, ...]
    steps: Floats
    values: Floats

    @property
    def mean(self) -> Floats:
        """Mean over seeds ``[T]``."""
        return self.values.mean(0)

    def band(self, confidence: float = 0.95) -> tuple[Floats, Floats]:
        """Student's t interval of the mean over seeds, two ``[T]``; the mean itself for a single seed."""
        count = len(self.values)
        if count < 2:
            return self.mean, self.mean
        half = stats.sem(self.values, axis=0) * stats.t.ppf(0.5 + confidence / 2, count - 1)
        return self.mean - half, self.mean + half

    def scaled(self, unit: float) -> Curve:
        """The same in another unit."""
        return Curve(self.seeds, self.steps, self.values * unit)

    def thinned(self, points: int) -> Curve:
        """At most about ``points`` points, each the mean of neighbouring ones, so that a page stays light."""
        every = -(-len(self.steps) // points)
        if every < 2:
            return self
        starts = np.arange(0, len(self.steps), every)
        counts = np.diff([*starts, len(self.steps)])
        ends = starts + counts - 1
        return Curve(
            self.seeds, self.steps[ends], np.add.reduceat(self.values, starts, axis=1) / counts
        )


def curve(series: Series) -> Curve:
    """Steps that every seed reached; where a step was logged twice, the last value counts."""
    per_seed = {seed: dict(points) for seed, points in series.items()}
    steps = sorted(set.intersection(*(set(points) for points in per_seed.values())))
    values = np.array([[points[t] for t in steps] for points in per_seed.values()])
    return Curve(tuple(per_seed), np.array(steps, dtype=float), values)
