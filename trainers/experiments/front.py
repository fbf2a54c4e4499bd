"""Success against a quantity that shall stay small: how much of one an arm pays for the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rrl.keys import METRICS

from ..evaluation.entries import CONTROLLER
from ..report.learning_curve import CONTROLLER_COLOR
from ..report.panels import ABOVE, quantity_title
from ..report.tables import with_interval
from .looks import COLORS, MARKERS, PANELS
from .outcomes import Finding, Outcome
from .spec import Experiment
from .tables import Table, interval_of

__all__ = ["SHOWN", "draw_front", "front_rows"]

HIGH = "_p99"
LIMIT = f"{ABOVE}limit"
SHOWN = (
    "large: mean of the seeds, bar: 95 % interval of success; small: each seed; "
    "dotted: to the mean of the 99th percentiles"
)
"""What the figure's marks are."""


def draw_front(experiment: Experiment, finding: Finding) -> tuple[Figure, list[Axes]]:
    """Draw a panel for every scenario: success over the mean of ``experiment.metric``.

    Return stands in for success where the environment reports none. See :data:`SHOWN`.
    """
    quantity, first = f"{METRICS}/{experiment.metric}", finding.outcomes[0]
    _, label, unit = _reached(first)
    title = quantity_title(quantity, _declared(experiment, first))
    limit = _declared(experiment, first)[str(experiment.metric)].get("limit")
    figure = Figure(figsize=(5.6 * len(first.scenarios), 4.8), layout="constrained")
    axes = list(figure.subplots(1, len(first.scenarios), squeeze=False)[0])
    for axis, scenario in zip(axes, first.scenarios, strict=True):
        _controller(axis, first, scenario, quantity)
        for i, outcome in enumerate(finding.outcomes):
            look = {"color": COLORS[i % len(COLORS)], "marker": MARKERS[i % len(MARKERS)]}
            _point(axis, outcome, scenario, quantity, look)
        if limit is not None:
            axis.axvline(limit, color="#999999", lw=1, label="limit of single episodes")
        axis.set(title=scenario, xlabel=title, ylabel=label)
        if axis.dataLim.x0 >= 0.0:
            axis.set_xlim(left=0.0)
        if unit == 100.0:
            axis.set_ylim(-3, 103)
    return figure, axes


def front_rows(experiment: Experiment, finding: Finding) -> Table:
    """Return success, and of the metric mean, 99th percentile and share above its limit.

    Success has its interval over seeds; of the metric the range over seeds stands beside the mean.
    """
    quantity, first = f"{METRICS}/{experiment.metric}", finding.outcomes[0]
    shown = [e for e in (quantity, quantity + HIGH, quantity + LIMIT) if first.knows(e)]
    titles = [quantity_title(e, _declared(experiment, first)) for e in shown]
    reached, label, unit = _reached(first)
    rows = []
    for scenario in first.scenarios:
        alone = [first.final(CONTROLLER + entry, scenario)[0] for entry in (reached, *shown)]
        units = [unit, *map(_unit, shown)]
        cells = [f"{u * value:.1f}" for value, u in zip(alone, units, strict=True)]
        rows.append([scenario, "controller alone", "", *cells])
        rows += [_row(outcome, scenario, reached, shown) for outcome in finding.outcomes]
    return ["scenario", "arm", "seeds", label, *titles], rows


def _row(outcome: Outcome, scenario: str, reached: str, shown: Sequence[str]) -> list[str]:
    mean, interval = (
        outcome.final(reached, scenario).mean(),
        interval_of(outcome, reached, scenario),
    )
    cells = [with_interval(mean, interval, _unit(reached))]
    for values in (outcome.final(entry, scenario) * _unit(entry) for entry in shown):
        cells.append(f"{values.mean():.1f} ({values.min():.1f} to {values.max():.1f})")
    return [scenario, outcome.point.arm, str(len(outcome.runs)), *cells]


def _point(
    axis: Axes, outcome: Outcome, scenario: str, quantity: str, look: dict[str, Any]
) -> None:
    reached, _, unit = _reached(outcome)
    values, each = outcome.final(quantity, scenario), unit * outcome.final(reached, scenario)
    axis.plot(values, each, ls="", ms=4, alpha=0.45, **look)
    at, height = values.mean(), each.mean()
    low, high = (unit * bound for bound in interval_of(outcome, reached, scenario))
    along = np.nan_to_num(np.maximum(0.0, [[height - low], [high - height]]))
    axis.errorbar(at, height, along, label=outcome.point.arm, capsize=3, ms=8, ls="", **look)
    _tail(axis, at, outcome.final(quantity + HIGH, scenario).mean(), height, look["color"])


def _controller(axis: Axes, outcome: Outcome, scenario: str, quantity: str) -> None:
    reached, _, unit = _reached(outcome)
    names = (quantity, quantity + HIGH, reached)
    at, high, height = (outcome.final(CONTROLLER + name, scenario)[0] for name in names)
    look: dict[str, Any] = {"color": CONTROLLER_COLOR, "marker": "*", "ms": 12, "ls": ""}
    axis.plot(at, unit * height, label="controller alone", **look)
    _tail(axis, at, high, unit * height, CONTROLLER_COLOR)


def _tail(axis: Axes, at: float, high: float, height: float, color: str) -> None:
    """Draw the way from a mean to the 99th percentile."""
    axis.plot([at, high], [height, height], ":", color=color, lw=1.2)
    axis.plot(high, height, "|", color=color, ms=9)


def _reached(outcome: Outcome) -> tuple[str, str, float]:
    return next(panel for panel in PANELS if outcome.knows(panel[0]))


def _declared(experiment: Experiment, outcome: Outcome) -> Mapping[str, Mapping[str, Any]]:
    """What the configuration says of the metric: unit, limit."""
    return {str(experiment.metric): outcome.point.config["env"]["metrics"][experiment.metric]}


def _unit(entry: str) -> float:
    return 100.0 if ABOVE in entry or entry == "success" else 1.0
