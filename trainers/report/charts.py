"""Interactive charts: one color a group of runs, thin lines for runs, a band for the interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..loggers import metrics
from .curves import Curve, Floats, controllers, view
from .panels import Panel
from .runs import Group

COLORS = ("#2f7fc1", "#d9622b", "#3a9d6a", "#9467bd", "#c59a1a", "#c2508b", "#4fa3a5", "#8c6d5a")
"""Readable on white and on black; the first ones differ for the color-blind."""
CONTROLLER_COLOR = "#8a929c"
DASHES = ("solid", "longdash", "longdashdot")
"""For one round of the colors after the other."""
COLUMNS, ROW_HEIGHT = 2, 330
MAX_POINTS = 120
"""Of one line; longer records are averaged in blocks."""
HOVER = "%{y:.4g} after %{x} steps"


def curves(groups: Sequence[Group], panels: Sequence[Panel]) -> go.Figure | None:
    """Draw panels over environment steps; None if no group logged any of them."""
    shown = [panel for panel in panels if any(group.curve(panel.metric) for group in groups)]
    if not shown:
        return None
    rows = -(-len(shown) // COLUMNS)
    titles = [panel.title for panel in shown]
    figure = make_subplots(rows, COLUMNS, subplot_titles=titles, vertical_spacing=0.28 / rows)
    named: set[str] = set()
    for i, panel in enumerate(shown):
        cell = {"row": i // COLUMNS + 1, "col": i % COLUMNS + 1}
        traces = _traces(groups, panel)
        for trace in traces:
            trace.showlegend = trace.name == trace.legendgroup and trace.name not in named
            named.add(trace.name)
            figure.add_trace(trace, **cell)
        axis = "environment steps" if i >= len(shown) - COLUMNS else None
        figure.update_xaxes(title={"text": axis, "font_size": 12}, **cell)
        # Not all of a band that few runs leave wide.
        lines = [trace.y for trace in traces if trace.fill is None]
        figure.update_yaxes(range=view(lines, 0.12), **cell)
    return _styled(figure, rows * ROW_HEIGHT + 90)


def time_split(groups: Sequence[Group]) -> go.Figure | None:
    """Draw the seconds of each part of the loop, mean of the runs; None if none was logged.

    The parts follow one another, so that a bar is as long as the runs took.
    """
    logged = {name for group in groups for name in group.metrics_of(metrics.TIME)}
    parts = [name for name in metrics.WHOLE_SECTIONS if name in logged]
    if not parts:
        return None
    labels = [group.label for group in groups]
    bars = [
        go.Bar(y=labels, x=[_seconds(g, part) for g in groups], name=part, orientation="h")
        for part in parts
    ]
    figure = go.Figure(bars)
    figure.update_layout(barmode="stack", xaxis_title="seconds", yaxis_autorange="reversed")
    figure.update_layout(legend_traceorder="normal")
    return _styled(figure, 160 + 34 * len(labels))


def _seconds(group: Group, part: str) -> float:
    return sum(run.seconds_of(part) for run in group.runs) / len(group.runs)


def _styled(figure: go.Figure, height: int) -> go.Figure:
    legend = {"orientation": "h", "yref": "container", "y": 0.995, "yanchor": "top", "x": 0}
    margin = {"l": 56, "r": 16, "t": 70, "b": 48}
    figure.update_annotations(font_size=14)
    figure.update_layout(height=height, hovermode="closest", template="none", margin=margin)
    figure.update_layout(legend=legend | {"xanchor": "left"})
    return figure


def _traces(groups: Sequence[Group], panel: Panel) -> list[go.Scatter]:
    lines = [(k, g, curve) for k, g in enumerate(groups) if (curve := g.curve(panel.metric))]
    end = max(curve.steps[-1] for _, _, curve in lines)
    traces = []
    for k, group, curve in lines:
        shown = curve if group.config["trainer"]["total_steps"] else curve.level(end)
        look = COLORS[k % len(COLORS)], DASHES[k // len(COLORS) % len(DASHES)]
        traces += _group_traces(group, panel, shown, *look)
    return traces + (_controllers(groups, panel, end) if panel.controller else [])


def _group_traces(
    group: Group, panel: Panel, curve: Curve, color: str, dash: str
) -> list[go.Scatter]:
    label, meta = group.label, {"Run": group.label}
    curve = curve if panel.counted else curve.thinned(MAX_POINTS)
    steps, scale = curve.steps, panel.scale
    dash = "dot" if group.config.get("arm") == "controller" else dash
    style = {"color": color, "width": 2.5, "dash": dash}
    mean = _line(steps, curve.mean * scale, label, label, style)
    mean.update(meta=meta | {"Show": "mean"}, zorder=1)
    if curve.known is not None:
        of = f"{HOVER}, mean of %{{customdata}} of {len(curve.seeds)} runs"
        mean.update(customdata=curve.known.sum(axis=0), hovertemplate=of)
    traces = [mean]
    counts = group.followed_episodes(steps) if panel.counted else None
    if bounds := curve.band(counts, panel.bounds):
        there = np.isfinite(bounds).all(axis=0)
        low, high = (bound[there] * scale for bound in bounds)
        there_and_back = np.append(steps[there], steps[there][::-1])
        band = _line(there_and_back, np.append(low, high[::-1]), "", label, {"width": 0})
        band.update(fill="toself", fillcolor=_transparent(color, 0.16), hoverinfo="skip")
        band.update(hovertemplate=None, meta=meta | {"Show": "95 % band"})
        traces.append(band)
    thin = {"color": _transparent(color, 0.45), "width": 0.9}
    for seed, row in zip(curve.seeds, curve.values if len(curve.seeds) > 1 else (), strict=False):
        line = _line(steps, row * scale, f"{label}, seed {seed}", label, thin)
        traces.append(line.update(meta=meta | {"Show": f"seed {seed}"}))
    if accepted := group.curve(panel.accepted):
        name, style = f"{label}, handed over", {"color": color, "width": 2, "dash": "dashdot"}
        line = _line(accepted.steps, accepted.mean * scale, name, name, style)
        traces.append(line.update(line_shape="hv", meta=meta | {"Show": "handed over"}))
    return traces


def _controllers(groups: Sequence[Group], panel: Panel, end: float) -> list[go.Scatter]:
    """The controller's level, once for all groups that it came to the same for."""
    learned_on = [group for group in groups if group.config["arm"] == "residual"]
    found = {group.label: group.curve(panel.controller) for group in learned_on}
    levels = {label: curve for label, curve in found.items() if curve}
    values = {label: frozenset(np.concatenate(curve.columns)) for label, curve in levels.items()}
    traces = []
    for name, labels in controllers(values).items():
        longest = max((levels[label] for label in labels), key=lambda curve: curve.steps[-1])
        level = longest.level(end)
        style = {"color": CONTROLLER_COLOR, "width": 2, "dash": "dash"}
        line = _line(level.steps, level.mean * panel.scale, name, name, style)
        traces.append(line.update(meta={"Show": "controller"}))
    return traces


def _line(x: Floats, y: Floats, name: str, group: str, style: dict[str, Any]) -> go.Scatter:
    mode = "lines" if len(x) > 1 else "markers"
    look = {"line": style, "mode": mode, "marker_color": style.get("color"), "hovertemplate": HOVER}
    return go.Scatter(x=x, y=y, name=name, legendgroup=group, **look)


def _transparent(color: str, alpha: float) -> str:
    red, green, blue = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{alpha})"
