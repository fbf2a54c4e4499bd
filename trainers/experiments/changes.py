"""What each change of the settings does on each task, against the first of the changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..evaluation.statistics import Interval, mean_interval, paired_interval, success_interval
from ..metric_names import CONTROLLER
from ..report.curves import Floats
from ..report.learning_curve import ACCEPTED_COLOR, RESIDUAL_COLOR
from ..report.runs import Run
from ..report.tables import handed_over, number, with_interval
from .figure_style import unit_of
from .outcomes import Finding, Outcome
from .spec import Experiment, arm_of
from .tables import Table

SHOWN = "difference to the first change, 95 % interval over runs and episodes (hollow: one run's)"
"""What the figure's marks are."""
READING = (
    "The controller and the first change are given as they are, the others as their difference to "
    "the first on the same seeds and the same episodes. The mean is over the tasks that the change "
    "is made on, if all of them report success. The tasks are fixed: its interval speaks of runs "
    "and episodes like these on these tasks. With a star: of a single run, on one of the tasks at "
    "least; the interval is over its episodes, and another seed may be far from it. No interval: "
    "numbers of a single run, or numbers that are all alike."
)
"""How the tables are to be read."""
MEAN = "mean of the tasks"
STAR = " *"
"""Behind the interval of a single run."""
Pair = tuple[Outcome, Outcome]
"""A task's arm with a change, and its arm with the first of the changes."""


@dataclass(frozen=True)
class Measure:
    """A number by which changes are compared.

    Attributes:
        name: What it is.
        of: A run and an entry to values: one for each frozen episode, or one for the whole run.
        color: In the figure.
    """

    name: str
    of: Callable[[Run, str], Floats]
    color: str


def _latest(run: Run, entry: str) -> Floats:
    return np.asarray(run.results[run.followed]["episodes"][entry], dtype=float)


def _handed_over(run: Run, entry: str) -> Floats:
    return np.asarray(handed_over(run.results[run.followed])["episodes"][entry], dtype=float)


def _on_the_way(run: Run, entry: str) -> Floats:
    return np.array([np.mean([value for _, value in run.evaluations(entry)])])


MEASURES = (
    Measure("the latest policy, final episodes", _latest, RESIDUAL_COLOR),
    Measure("the latest policy, mean of the evaluations during training", _on_the_way, "#e69f00"),
    Measure("what is handed over, final episodes", _handed_over, ACCEPTED_COLOR),
)


def change_rows(experiment: Experiment, finding: Finding, measure: Measure) -> Table:
    """Return a row for the controller, one for the first change, and what each other one does."""
    base, *others = experiment.all_changes
    first = _pairs(experiment, finding, base)
    alone = [_level(outcome, measure, CONTROLLER) for outcome, _ in first.values()]
    levels = [_level(outcome, measure) for outcome, _ in first.values()]
    rows = [["the controller alone", *alone, ""], [base, *levels, ""]]
    for change in others:
        pairs = _pairs(experiment, finding, change)
        cells = [_cell([pairs[task]], measure) if task in pairs else "" for task in first]
        rows.append([change, *cells, _cell(_all(experiment, pairs, change), measure)])
    return ["change", *first, MEAN], rows


def draw_changes(experiment: Experiment, finding: Finding) -> Figure:
    """Draw a panel for every task and one for their mean: what the changes do, by each measure."""
    base, *others = experiment.all_changes
    tasks = list(_pairs(experiment, finding, base))
    size = 2.4 + 2.3 * (len(tasks) + 1), 1.6 + 0.34 * len(others)
    figure = Figure(figsize=size, layout="constrained")
    axes = list(figure.subplots(1, len(tasks) + 1, sharey=True, squeeze=False)[0])
    for axis, task in zip(axes, [*tasks, MEAN], strict=True):
        for row, change in enumerate(others):
            pairs = _pairs(experiment, finding, change)
            shown = [pairs[task]] if task in pairs else []
            if task == MEAN:
                shown = _all(experiment, pairs, change)
            for n, measure in enumerate(MEASURES):
                _mark(axis, shown, measure, row + 0.22 * (n - 1))
        axis.axvline(0.0, color="#999999", lw=1)
        axis.set_title(task, fontsize=9)
        axis.set_xlabel("difference in success [%], else in return", fontsize=8)
        axis.tick_params(labelsize=8)
    axes[0].set_yticks(range(len(others)), others)
    axes[0].set_ylim(len(others) - 0.5, -0.5)
    return figure


def _pairs(experiment: Experiment, finding: Finding, change: str) -> dict[str, Pair]:
    """By task the arms to compare, where both have a run with the same seed."""
    arms = {outcome.point.arm: outcome for outcome in finding.outcomes}
    found = {}
    for task in experiment.tasks:
        with_change, base = (
            arms.get(arm_of(task, name)) for name in (change, experiment.all_changes[0])
        )
        if with_change and base and _common((with_change, base)):
            found[task] = with_change, base
    return found


def _all(experiment: Experiment, pairs: dict[str, Pair], change: str) -> list[Pair]:
    """All tasks that the change is made on; none while one of them is to come."""
    planned = sum(arm_of(task, change) in experiment.all_arms for task in experiment.tasks)
    return list(pairs.values()) if len(pairs) == planned else []


def _seeds(outcome: Outcome) -> set[int]:
    return {run.seed for run in outcome.runs}


def _common(pair: Pair) -> set[int]:
    """The seeds that are compared."""
    return set.intersection(*map(_seeds, pair))


def _is_single(pairs: Sequence[Pair]) -> bool:
    """Whether on a task there is one run to compare."""
    return any(len(_common(pair)) == 1 for pair in pairs)


def _effect(pairs: Sequence[Pair], measure: Measure) -> tuple[float, Interval] | None:
    """The mean over tasks of what a change does; None of tasks that are measured differently."""
    entries = {outcome.measured_by for pair in pairs for outcome in pair}
    if entries != {"success"} and len(pairs) != 1:
        return None
    entry = entries.pop()
    tables = []
    for pair in pairs:
        changed, base = (
            np.array([measure.of(run, entry) for run in outcome.runs if run.seed in _common(pair)])
            for outcome in pair
        )
        tables.append(changed - base)  # (S, N)
    by_episode = entry == "success" and all(table.shape[1] > 1 for table in tables)
    change = float(np.mean([table.mean() for table in tables]))
    interval = paired_interval(*tables, bound=1.0 if by_episode else None)
    return change, _within(interval, -1.0, entry)


def _cell(pairs: Sequence[Pair], measure: Measure) -> str:
    if not pairs or (found := _effect(pairs, measure)) is None:
        return ""
    text = with_interval(*found, unit_of(pairs[0][0].measured_by), sign="+")
    return _starred(text, found[1]) if _is_single(pairs) else text


def _within(interval: Interval, least: float, entry: str) -> Interval:
    """Cut an interval of successes, or of their difference, off at what there can be."""
    low, high = np.clip(interval, least, 1.0) if entry == "success" else interval
    return float(low), float(high)


def _starred(text: str, interval: Interval) -> str:
    """Mark a single run's interval, if it has one."""
    return text + STAR if np.isfinite(interval[0]) else text


def _level(outcome: Outcome, measure: Measure, prefix: str = "") -> str:
    """What an arm came to; its controller, alike in all runs, without an interval."""
    entry = outcome.measured_by
    values = np.array([measure.of(run, prefix + entry) for run in outcome.runs])  # (S, N)
    unit = unit_of(entry)
    if prefix:
        return number(values.mean(), unit)
    by_episode = entry == "success" and values.shape[1] > 1
    interval = success_interval(values) if by_episode else mean_interval(values.mean(axis=1))
    interval = _within(interval, 0.0, entry)
    text = with_interval(values.mean(), interval, unit)
    return _starred(text, interval) if len(values) == 1 else text


def _mark(axis: Axes, pairs: Sequence[Pair], measure: Measure, height: float) -> None:
    found = _effect(pairs, measure) if pairs else None
    if found is None:
        return
    (change, interval), unit = found, unit_of(pairs[0][0].measured_by)
    error = unit * np.nan_to_num(np.abs(np.subtract(interval, change)))[:, None]
    look: dict[str, Any] = {"color": measure.color, "capsize": 2, "ms": 4, "lw": 1.2}
    look |= {"mfc": "white"} if _is_single(pairs) else {}
    axis.errorbar(unit * change, height, xerr=error, fmt="o", label=measure.name, **look)
