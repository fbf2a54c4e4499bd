"""Figures of one or more runs, with confidence bands over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..evaluation.statistics import mean_interval
from ..loggers import metrics, read_metrics

RESIDUAL_COLOUR, CONTROLLER_COLOUR = "#1b6ca8", "#c1440e"

Series = Mapping[int, Sequence[tuple[int, float]]]
"""Seed to ``(env_steps, value)`` in order."""


def learning_curve(run_dirs: Sequence[Path], scenario: str, out: Path) -> Path:
    """Draw success and return over environment steps and write ``out`` (and the same as SVG).

    Each thin line is one seed; the band is the 95 % confidence interval of the mean over seeds (Student's t), as in
    the paper; the dashed line is the controller alone on the same episodes.

    Args:
        run_dirs: directories of runs that differ by the seed.
        scenario: which of its scenarios.
        out: the PNG file.

    """
    record: dict[str, dict[int, Sequence[tuple[int, float]]]] = {}
    for run_dir in run_dirs:
        for name, series in read_metrics(run_dir).items():
            record.setdefault(name, {}).update(series)
    panels = [
        ("success", "success rate [%]", 100.0),
        ("return", "return of an episode", 1.0),
    ]
    available = [p for p in panels if metrics.name(metrics.EVALUATION, scenario, p[0]) in record]
    figure = Figure(figsize=(5.2 * len(available), 3.8), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(available)))
    for axis, (metric, label, unit) in zip(axes, available, strict=True):
        _draw_panel(axis, record, scenario, metric, unit)
        axis.set_ylabel(label)
        axis.set_xlabel("environment steps of one seed")
        if metric == "success":
            axis.set_ylim(-3, 103)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False)
    seeds = len(record[metrics.name(metrics.EVALUATION, scenario, available[0][0])])
    band = ", mean and 95 % confidence interval" if seeds > 1 else ""
    figure.suptitle(f"{scenario}: {seeds} seed{'s' * (seeds > 1)}{band}", fontsize=11)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=150)
    figure.savefig(out.with_suffix(".svg"))
    return out


def _draw_panel(
    axis: Axes, record: Mapping[str, Series], scenario: str, metric: str, unit: float
) -> None:
    steps, values = _table(record[metrics.name(metrics.EVALUATION, scenario, metric)])
    values = values * unit
    low, high = np.array([mean_interval(column) for column in values.T]).T
    if metric == "success":  # the t interval of a rate may leave [0, 1]
        low, high = low.clip(0, unit), high.clip(0, unit)
    axis.fill_between(steps, low, high, color=RESIDUAL_COLOUR, alpha=0.2, linewidth=0)
    if len(values) > 1:
        axis.plot(steps, values.T, color=RESIDUAL_COLOUR, linewidth=0.6, alpha=0.45)
    axis.plot(steps, values.mean(0), color=RESIDUAL_COLOUR, linewidth=2, label="residual RL")
    _, controller = _table(
        record[metrics.name(metrics.EVALUATION, scenario, f"controller_{metric}")]
    )
    axis.plot(
        steps,
        controller.mean(0) * unit,
        color=CONTROLLER_COLOUR,
        linewidth=2,
        linestyle="--",
        label="controller alone",
    )
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)


def _table(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """Steps ``[T]`` and values ``[S, T]``; where a step was evaluated twice, the last value counts."""
    per_seed = [dict(points) for points in series.values()]
    steps = sorted(set.intersection(*(set(points) for points in per_seed)))
    return np.array(steps), np.array([[points[t] for t in steps] for points in per_seed])
