"""Success against a quantity that shall stay small: how much of one an arm pays for the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rrl.keys import METRICS

from ..metric_names import ABOVE, CONTROLLER, P99, decimals
from ..report.curves import ALONE, controllers
from ..report.learning_curve import CONTROLLER_COLOR
from ..report.panels import Declared, agreed, quantity_title
from ..report.tables import with_interval
from .figure_style import PANELS, color_of, marked, unit_of
from .outcomes import Finding, Outcome
from .spec import Experiment
from .tables import Table, interval_of

SHOWN = (
    "large: mean of the seeds, bar: 95 % interval of success; small: each seed; "
    "dotted: to the mean of the 99th percentiles"
)
"""What the figure's marks are."""


def draw_front(experiment: Experiment, finding: Finding) -> Figure:
    """Draw a panel for every scenario: success over the mean of ``experiment.metric``.

    Return stands in for success where the environment reports none. See :data:`SHOWN`.
    """
    quantity, first = f"{METRICS}/{experiment.metric}", finding.outcomes[0]
    declared, alone = _declared(experiment, finding), _controllers(finding, quantity)
    reached, limit = first.measured_by, declared[str(experiment.metric)].get("limit")
    figure = Figure(figsize=(5.6 * len(finding.scenarios), 4.8), layout="constrained")
    axes = list(figure.subplots(1, len(finding.scenarios), squeeze=False)[0])
    for axis, scenario in zip(axes, finding.scenarios, strict=True):
        for i, outcome in enumerate(finding.outcomes):
            if scenario not in outcome.scenarios:
                continue
            for name in [name for name, below in alone.items() if below is outcome]:
                _controller(axis, outcome, scenario, quantity, name, color_of(i))
            _point(axis, outcome, scenario, quantity, marked(i))
        if limit is not None:
            axis.axvline(limit, color="#999999", lw=1, label="limit of single episodes")
        title = quantity_title(quantity, declared)
        axis.set(title=scenario, xlabel=title, ylabel=PANELS[reached])
        if axis.dataLim.x0 >= 0.0:
            axis.set_xlim(left=0.0)
        if reached == "success":
            axis.set_ylim(-3, 103)
    return figure


def front_rows(experiment: Experiment, finding: Finding) -> Table:
    """Return success, and of the metric mean, 99th percentile and share above its limit.

    Success has its interval over seeds; of the metric the range over seeds stands beside the mean.
    """
    quantity, first = f"{METRICS}/{experiment.metric}", finding.outcomes[0]
    entries = (quantity, quantity + P99, quantity + ABOVE["limit"])
    shown = [e for e in entries if all(outcome.knows(e) for outcome in finding.outcomes)]
    declared = _declared(experiment, finding)
    titles = [quantity_title(e, declared) for e in shown]
    reached = first.measured_by
    rows = []
    for scenario in finding.scenarios:
        for name, below in _controllers(finding, quantity).items():
            if scenario in below.scenarios:
                cells = _alone(below, scenario, (reached, *shown))
                rows.append([scenario, name, "", *(_written(cell) for cell in cells)])
        having = [outcome for outcome in finding.outcomes if scenario in outcome.scenarios]
        rows += [_row(outcome, scenario, reached, shown) for outcome in having]
    return ["scenario", "arm", "seeds", PANELS[reached], *titles], rows


def _controllers(finding: Finding, quantity: str) -> dict[str, Outcome]:
    """The controllers whose marks differ, by name, each with the first arm that it is below."""
    below = {outcome.point.label: outcome for outcome in finding.outcomes if not outcome.acts_alone}
    values = {label: _marks(outcome, quantity) for label, outcome in below.items()}
    return {name: below[labels[0]] for name, labels in controllers(values).items()}


def _marks(outcome: Outcome, quantity: str) -> tuple[float, ...]:
    """What the controller came to in all scenarios."""
    entries = _entries(outcome, quantity)
    return tuple(value for s in outcome.scenarios for value in _alone(outcome, s, entries))


def _row(outcome: Outcome, scenario: str, reached: str, shown: Sequence[str]) -> list[str]:
    mean = outcome.final(reached, scenario).mean()
    cells = [with_interval(mean, interval_of(outcome, reached, scenario), unit_of(reached))]
    for values in (outcome.final(entry, scenario) * unit_of(entry) for entry in shown):
        mean, least, most = _written(values.mean(), values.min(), values.max()).split()
        cells.append(f"{mean} ({least} to {most})")
    return [scenario, outcome.point.label, str(len(outcome.runs)), *cells]


def _written(*values: float) -> str:
    """Write numbers beside one another, each with as many decimals."""
    return " ".join(f"{value:.{decimals(*values, least=1)}f}" for value in values)


def _point(
    axis: Axes, outcome: Outcome, scenario: str, quantity: str, look: dict[str, Any]
) -> None:
    reached, unit = outcome.measured_by, unit_of(outcome.measured_by)
    values, each = outcome.final(quantity, scenario), unit * outcome.final(reached, scenario)
    axis.plot(values, each, ls="", ms=4, alpha=0.45, **look)
    at, height = values.mean(), each.mean()
    low, high = (unit * bound for bound in interval_of(outcome, reached, scenario))
    along = np.nan_to_num(np.maximum(0.0, [[height - low], [high - height]]))
    axis.errorbar(at, height, along, label=outcome.point.label, capsize=3, ms=8, ls="", **look)
    _tail(axis, at, outcome.final(quantity + P99, scenario).mean(), height, look["color"])


def _controller(
    axis: Axes, below: Outcome, scenario: str, quantity: str, name: str, color: str
) -> None:
    """Draw a controller alone; one of a few arms only in the color of the first of them."""
    color = CONTROLLER_COLOR if name == ALONE else color
    height, at, high = _alone(below, scenario, _entries(below, quantity))
    axis.plot(at, height, "*", color=color, ms=12, label=name)
    _tail(axis, at, high, height, color)


def _entries(outcome: Outcome, quantity: str) -> tuple[str, ...]:
    """What a mark shows: its height, its place and the end of its tail."""
    return outcome.measured_by, quantity, quantity + P99


def _alone(outcome: Outcome, scenario: str, entries: Sequence[str]) -> list[float]:
    """What the controller came to, as it is shown."""
    return [unit_of(e) * float(outcome.final(CONTROLLER + e, scenario)[0]) for e in entries]


def _tail(axis: Axes, at: float, high: float, height: float, color: str) -> None:
    """Draw the way from a mean to the 99th percentile."""
    axis.plot([at, high], [height, height], ":", color=color, lw=1.2)
    axis.plot(high, height, "|", color=color, ms=9)


def _declared(experiment: Experiment, finding: Finding) -> Declared:
    """What all configurations say of the metric: unit, limit."""
    name = str(experiment.metric)
    return agreed({name: o.point.config["env"]["metrics"][name] or {}} for o in finding.outcomes)
