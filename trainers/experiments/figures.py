"""The figures of the experiments, each as PNG and SVG."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..evaluation.statistics import mean_interval
from ..metric_names import ACCEPTED, CONTROLLER
from ..report.curves import ALONE, alike, controllers
from ..report.learning_curve import (
    ACCEPTED_COLOR,
    CONTROLLER_COLOR,
    RESIDUAL_COLOR,
    draw_mean,
    look_at_lines,
)
from . import changes, front
from .figure_style import HATCHES, LINES, PANELS, color_of, marked, of_round, unit_of
from .outcomes import Finding, Outcome
from .spec import Experiment
from .tables import final_rows, interval_of, outcome_rows

TASK_COLUMNS = 3
ROW = 0.21
"""Inches of a row of the legend; figures have room for two."""
INTERVAL = "mean of the seeds and its 95 % interval"


@rc_context({"text.parse_math": False})  # a name with two dollar signs is no formula
def draw(experiment: Experiment, finding: Finding, folder: Path) -> Path:
    """Draw an experiment's figure; return the PNG, with the SVG beside it."""
    kinds = {"curves": _curves, "sweep": _sweep, "spread": _spread, "table": _table}
    kinds |= {"tasks": _tasks, "front": front.draw_front, "changes": changes.draw_changes}
    figure = kinds[experiment.figure](experiment, finding)
    if experiment.figure != "table":
        _finish(figure, experiment, finding)
    folder.mkdir(parents=True, exist_ok=True)
    out = folder / f"{experiment.name}.png"
    for path in (out, out.with_suffix(".svg")):  # as wide as what is written on it
        figure.savefig(path, dpi=150, bbox_inches="tight")
    return out


def _curves(experiment: Experiment, finding: Finding) -> Figure:
    figure, panels = _panels(finding)
    for axis, entry in panels:
        for i, outcome in enumerate(finding.outcomes):
            if outcome.follows(entry):
                look = color_of(i), outcome.point.label, of_round(i, LINES)
                _band(axis, outcome, entry, *look)
        _controllers(axis, finding, entry)
        look_at_lines(axis, is_rate=entry == "success")
        axis.set_xlabel("environment steps of one seed")
    return figure


def _controllers(axis: Axes, finding: Finding, entry: str) -> None:
    """Draw the controllers alone, dashed: several in the colors of what learns on top of them."""
    level = CONTROLLER + entry
    having = [i for i, o in enumerate(finding.outcomes) if not o.acts_alone and o.follows(level)]
    curves = {i: finding.outcomes[i].curve(level) for i in having}
    same = alike(having, lambda i: frozenset(curves[i].values.ravel()))
    for n, of_one in enumerate(same):
        curve = max((curves[i] for i in of_one), key=lambda curve: curve.steps[-1])
        color = CONTROLLER_COLOR if len(same) == 1 else color_of(of_one[0])
        label = ALONE if len(same) == 1 else "the controller below it alone"
        shown = label if n == 0 else None
        axis.plot(curve.steps, unit_of(level) * curve.mean, "--", color=color, lw=1.4, label=shown)


def _sweep(experiment: Experiment, finding: Finding) -> Figure:
    assert experiment.sweep is not None
    figure, panels = _panels(finding)
    looks = {arm: marked(i) for i, arm in enumerate(finding.arms)}
    for axis, entry in panels:
        arms = {arm: finding.arm(arm) for arm in finding.arms}
        arms = {arm: found for arm, found in arms.items() if all(o.knows(entry) for o in found)}
        for arm, found in arms.items():
            _errors(axis, found, entry, arm, **looks[arm])
        levels = {  # what the controllers came to at every setting
            arm: tuple(float(outcome.final(CONTROLLER + entry)[0]) for outcome in found)
            for arm, found in arms.items()
            if not found[0].acts_alone
        }
        for name, (arm, *_) in controllers(levels).items():
            color = CONTROLLER_COLOR if name == ALONE else looks[arm]["color"]
            look = {"color": color, "marker": "s", "linestyle": "--"}
            _errors(axis, arms[arm], CONTROLLER + entry, name, **look)
        axis.set_xlabel(experiment.sweep.label)
        axis.set_ylabel(f"final {axis.get_ylabel()}")
    return figure


def _spread(experiment: Experiment, finding: Finding) -> Figure:
    spread = experiment.spread
    assert spread is not None
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axis = figure.subplots()
    width = 0.8 / len(finding.outcomes)
    for i, outcome in enumerate(finding.outcomes):
        per_axis = outcome.variances()
        values = np.column_stack([per_axis, per_axis.sum(axis=1)])  # (S, axes + 1)
        at = np.arange(values.shape[1]) + (i - (len(finding.outcomes) - 1) / 2) * width
        low, high = np.array([mean_interval(column) for column in values.T]).T
        mean = values.mean(axis=0)
        error = np.nan_to_num([mean - np.maximum(low, 0.0), high - mean])
        look: dict[str, Any] = {"capsize": 3, "color": color_of(i), "hatch": of_round(i, HATCHES)}
        look |= {"alpha": 0.75}
        axis.bar(at, mean, 0.9 * width, yerr=error, label=outcome.point.label, **look)
        for row in values:
            axis.plot(at, row, ".", color="black", ms=4, alpha=0.6)
    axis.set_xticks(range(values.shape[1]), [*spread.axes, "sum"])
    axis.set_xlabel("direction")
    axis.set_ylabel(f"variance of the {spread.name}s visited [{spread.unit}²]")
    return figure


def _table(experiment: Experiment, finding: Finding) -> Figure:
    """Draw the successes as a table, or the returns where no success is reported."""
    header, rows = outcome_rows(experiment, finding)
    if not rows:
        header, rows = final_rows(experiment, finding)
    figure = Figure(figsize=(11.0, 1.0))
    axis = figure.subplots()
    axis.axis("off")
    table = axis.table(
        rows,
        colLabels=header,
        loc="upper center",
        cellLoc="left",
        colLoc="left",
        edges="horizontal",
    )
    table.auto_set_font_size(False)
    table.set_fontsize(9)
    table.auto_set_column_width(range(len(header)))
    table.scale(1, 1.6)
    shown = f"the same {finding.outcomes[0].episodes} episodes for each and the controller"
    axis.set_title(f"{experiment.heading}\n{_seeds(finding)}, {shown}", fontsize=10)
    return figure


def _tasks(experiment: Experiment, finding: Finding) -> Figure:
    """Draw one small panel for every arm: its success, or its return where none is reported."""
    count = len(finding.outcomes)
    columns = min(TASK_COLUMNS, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(3.4 * columns, 2.4 * rows + 0.9), layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axis, outcome in zip(axes, finding.outcomes, strict=False):
        entry = outcome.measured_by
        _band(axis, outcome, entry, RESIDUAL_COLOR, "latest policy")
        if not outcome.acts_alone:
            _level(axis, outcome, CONTROLLER + entry, "--", CONTROLLER_COLOR, "controller")
        if outcome.follows(ACCEPTED + entry):
            _level(axis, outcome, ACCEPTED + entry, ":", ACCEPTED_COLOR, "handed over")
        axis.set_title(textwrap.fill(outcome.point.label, 38), fontsize=9)
        axis.set_ylabel(PANELS[entry], fontsize=8)
        axis.tick_params(labelsize=8)
        look_at_lines(axis, is_rate=entry == "success")
    for axis in axes[count:]:
        axis.axis("off")
    for axis in axes[count - columns : count]:
        axis.set_xlabel("environment steps of one seed", fontsize=8)
    return figure


def _level(axis: Axes, outcome: Outcome, entry: str, style: str, color: str, label: str) -> None:
    curve = outcome.curve(entry)
    axis.plot(curve.steps, unit_of(entry) * curve.mean, style, color=color, lw=1.8, label=label)


def _panels(finding: Finding) -> tuple[Figure, list[tuple[Axes, str]]]:
    """Return axes for the entries that any of the arms reports."""
    known = [entry for entry in PANELS if any(o.knows(entry) for o in finding.outcomes)]
    figure = Figure(figsize=(5.6 * len(known), 4.2), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(1, len(known))))
    for axis, entry in zip(axes, known, strict=True):
        axis.set_ylabel(PANELS[entry])
        if entry == "success":
            axis.set_ylim(-3, 103)
    return figure, list(zip(axes, known, strict=True))


def _finish(figure: Figure, experiment: Experiment, finding: Finding) -> None:
    """Add a legend of all panels and a title."""
    named: dict[str, Any] = {}
    for axis in figure.axes:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
        handles, labels = axis.get_legend_handles_labels()
        named = dict(zip(labels, handles, strict=True)) | named
    look: dict[str, Any] = {"loc": "outside lower center", "frameon": False, "fontsize": 9}
    fitting = int(figure.get_figwidth() / (0.6 + 0.075 * max(map(len, named), default=0)))
    columns = max(1, min(3, fitting))
    figure.legend(list(named.values()), list(named), ncols=columns, **look)
    figure.set_figheight(figure.get_figheight() + ROW * max(0, -(-len(named) // columns) - 2))
    shown = {"front": front.SHOWN, "changes": changes.SHOWN}.get(experiment.figure, INTERVAL)
    figure.suptitle(f"{experiment.heading}\n{_seeds(finding)}, {shown}", fontsize=10)


def _seeds(finding: Finding) -> str:
    """Return how many seeds the arms have, from the fewest to the most."""
    counts = sorted({len(outcome.runs) for outcome in finding.outcomes})
    some = " to ".join(str(count) for count in dict.fromkeys((counts[0], counts[-1])))
    return f"{some} seed" if counts == [1] else f"{some} seeds"


def _band(
    axis: Axes, outcome: Outcome, entry: str, color: str, label: str, line: str = "-"
) -> None:
    curve = outcome.curve(entry)
    band = curve.band(outcome.followed_episodes if entry == "success" else None)
    draw_mean(axis, curve, band, unit_of(entry), color, label, line=line)


def _errors(axis: Axes, outcomes: Sequence[Outcome], entry: str, label: str, **look: Any) -> None:
    """Draw final values over the sweep; the controller's are the same for every seed."""
    mean = np.array([outcome.final(entry).mean() for outcome in outcomes])
    low, high = mean, mean
    if not entry.startswith(CONTROLLER):
        low, high = np.array([interval_of(outcome, entry) for outcome in outcomes]).T
    at = [outcome.point.value or 0.0 for outcome in outcomes]
    unit = unit_of(entry)
    error = unit * np.nan_to_num(np.maximum(0.0, [mean - low, high - mean]))
    axis.errorbar(at, unit * mean, error, capsize=3, lw=2, ms=5, label=label, **look)
