"""A picture of success and return over environment steps, with intervals over runs."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .panels import LEARNING, Panel
from .runs import Group

__all__ = ["ACCEPTED_COLOR", "CONTROLLER_COLOR", "RESIDUAL_COLOR", "learning_curve"]

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
    figure.savefig(out, dpi=150)
    figure.savefig(out.with_suffix(".svg"))
    return out


def _draw(axis: Axes, group: Group, panel: Panel) -> None:
    found = group.curve(panel.metric)
    assert found is not None
    steps, values = found.steps, found.values * panel.scale
    if band := found.band(group.followed_episodes if panel.counted else None, panel.bounds):
        low, high = (bound * panel.scale for bound in band)
        fill = axis.fill_between(steps, low, high, color=RESIDUAL_COLOR, alpha=0.2, linewidth=0)
        fill.set_label("95 % interval")
    if len(values) > 1:
        axis.plot(steps, values.T, color=RESIDUAL_COLOR, linewidth=0.6, alpha=0.45)
    axis.plot(steps, values.mean(0), color=RESIDUAL_COLOR, linewidth=2, label="residual RL")
    if level := group.curve(panel.controller):
        (line,) = axis.plot(level.steps, level.mean * panel.scale, "--", linewidth=2)
        line.set(color=CONTROLLER_COLOR, label="controller alone")
    if accepted := group.curve(panel.accepted):
        (line,) = axis.plot(accepted.steps, accepted.mean * panel.scale, ":", linewidth=2)
        line.set(color=ACCEPTED_COLOR, label="handed over", drawstyle="steps-post")
    axis.set_ylabel(panel.title)
    axis.set_xlabel("environment steps")
    if panel.counted:
        axis.set_ylim(-3, 103)
    axis.grid(alpha=0.25)
    axis.spines[["top", "right"]].set_visible(False)
