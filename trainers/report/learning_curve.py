"""A picture of success and return over environment steps, with intervals over runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .curves import ALONE, Curve, Floats, view
from .panels import LEARNING, Panel
from .runs import Group

RESIDUAL_COLOR, CONTROLLER_COLOR = "#1b6ca8", "#c1440e"
ACCEPTED_COLOR = "#222222"


def learning_curve(group: Group, out: Path) -> Path | None:
    """Draw success and return of the followed episodes, and write ``out`` (and the same as SVG).

    Thick lines are means over runs, bands their 95 % intervals, thin lines runs; the dashed line is
    the controller alone on the same episodes, the dotted one what the run would hand over.

    Args:
        group: One run, or runs that differ by the seed.
        out: The PNG file.

    Returns:
        ``out``, or None if the runs logged no evaluation.
    """
    panels = [panel for panel in LEARNING if group.curve(panel.metric)]
    if not panels:
        return None
    figure = Figure(figsize=(5.2 * len(panels), 3.8), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for axis, panel in zip(axes, panels, strict=True):
        _draw(axis, group, panel)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    runs = f"{len(group.runs)} runs" if len(group.runs) > 1 else "one run"
    figure.suptitle(f"{group.label}, {group.followed}: {runs}", fontsize=11)
    out.parent.mkdir(parents=True, exist_ok=True)
    for path in (out, out.with_suffix(".svg")):  # as wide as the run's name
        figure.savefig(path, dpi=150, bbox_inches="tight")
    return out


def draw_mean(
    axis: Axes,
    curve: Curve,
    band: tuple[Floats, Floats] | None,
    scale: float,
    color: str,
    label: str,
    band_label: str | None = None,
    line: str = "-",
) -> None:
    """Draw a mean over runs with its interval, if there is one; both are multiplied by a scale."""
    if band:
        low, high = (scale * bound for bound in band)
        look: dict[str, Any] = {"color": color, "alpha": 0.18, "linewidth": 0}
        axis.fill_between(curve.steps, low, high, label=band_label, **look)
    axis.plot(curve.steps, scale * curve.mean, line, color=color, linewidth=2, label=label)


def look_at_lines(axis: Axes, *, is_rate: bool) -> None:
    """Show rates from none to all, and of others all lines: not all of a wide band of few runs."""
    lines = [np.asarray(line.get_ydata(), dtype=float) for line in axis.get_lines()]
    axis.set_ylim(*((-3, 103) if is_rate else view(lines, 0.25)))


def _draw(axis: Axes, group: Group, panel: Panel) -> None:
    found = group.curve(panel.metric)
    assert found is not None
    if len(found.seeds) > 1:
        each = found.values.T * panel.scale
        axis.plot(found.steps, each, color=RESIDUAL_COLOR, linewidth=0.6, alpha=0.45)
    counts = group.followed_episodes(found.steps) if panel.counted else None
    band = found.band(counts, panel.bounds)
    draw_mean(axis, found, band, panel.scale, RESIDUAL_COLOR, "residual RL", "95 % interval")
    if level := group.curve(panel.controller):
        (line,) = axis.plot(level.steps, level.mean * panel.scale, "--", linewidth=2)
        line.set(color=CONTROLLER_COLOR, label=ALONE)
    if accepted := group.curve(panel.accepted):
        (line,) = axis.plot(accepted.steps, accepted.mean * panel.scale, ":", linewidth=2)
        line.set(color=ACCEPTED_COLOR, label="handed over", drawstyle="steps-post")
    axis.set_ylabel(panel.title)
    axis.set_xlabel("environment steps")
    look_at_lines(axis, is_rate=panel.counted)
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)
