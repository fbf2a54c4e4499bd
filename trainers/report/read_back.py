"""The one place that reads ``results.json`` and ``metrics.csv`` of runs of one seed.

It reads both the format with seeds side by side and the one with a single seed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .runs import Run

__all__ = ["episode_count", "final_summary", "metric_points", "success_interval"]

try:
    from ..evaluation.statistics import success_interval
except ImportError:  # until the branches meet
    from ..evaluation.statistics import mean_interval, wilson

    def success_interval(
        successes: Sequence[int], episodes: int, confidence: float = 0.95
    ) -> tuple[float, float]:
        """Return an interval of the mean success rate of runs like these."""
        if len(successes) == 1:
            return wilson(int(successes[0]), episodes, confidence)
        padded = [(count + 0.5) / (episodes + 1) for count in successes]
        low, high = mean_interval(padded, confidence)
        alone = wilson(round(sum(successes) / len(successes)), episodes, confidence)
        return max(0.0, min(low, alone[0])), min(1.0, max(high, alone[1]))


def final_summary(run: Run, scenario: str | None = None) -> Mapping[str, float]:
    """Return the final evaluation of a run's policy in a scenario; None: the followed one.

    Raises:
        KeyError: If the run is not finished or does not know the scenario.
    """
    record: Any = run.results[scenario or run.followed]
    return record["summary"] if "summary" in record else next(iter(record.values()))


def episode_count(run: Run, scenario: str | None = None) -> int:
    """Return the number of episodes of the final evaluation."""
    record: Any = run.results[scenario or run.followed]
    if "episodes" in record:
        return len(record["episodes"]["return"])
    return int(run.config["trainer"]["evaluation"]["final_episodes"])


def metric_points(run: Run, metric: str) -> Sequence[tuple[int, float]]:
    """Return a metric's ``(env_steps, value)`` in order; empty if it was not logged."""
    series: Any = run.record.get(metric, ())
    return next(iter(series.values())) if isinstance(series, Mapping) else series
