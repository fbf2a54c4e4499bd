"""Interactive charts of several runs: one colour a run, thin lines for seeds, a band for the mean's interval."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from ..loggers import metrics
from .curves import Curve, Floats
from .panels import Panel
from .runs import Run

COLOURS = ("#2f7fc1", "#d9622b", "#3a9d6a", "#9467bd", "#c59a1a", "#c2508b", "#4fa3a5", "#8c6d5a")
"""Readable on white and on black, apart for the colour-blind at the front."""

CONTROLLER_COLOUR = "#8a929c"
COLUMNS = 2
ROW_HEIGHT = 330
MAX_POINTS = 120
"""Of one line; longer records are averaged in blocks."""


def curves(runs: Sequence[Run], panels: Sequence[Panel]) -> go.Figure | None:
    """A grid of panels over environment steps; those that no run has anything for are left out.

    Returns:
        The figure, or None if nothing is left.
    """
    shown = [p for p in panels if any(run.curve(p.metric) for run in runs)]
    if not shown:
        return None
    rows = -(-len(shown) // COLUMNS)
    figure = make_subplots(
        rows, COLUMNS, subplot_titles=[p.title for p in shown], vertical_spacing=0.28 / rows
    )
    named: set[str] = set()
    for i, panel in enumerate(shown):
        place = {"row": i // COLUMNS + 1, "col": i % COLUMNS + 1}
        traces = _traces(runs, panel)
        for trace in traces:
            trace.showlegend = trace.name == trace.legendgroup and trace.name not in named
            named.add(trace.name)
            figure.add_trace(trace, **place)
        axis = "environment steps of one seed" if i >= len(shown) - COLUMNS else None
        figure.update_xaxes(title={"text": axis, "font_size": 12}, **place)
        figure.update_yaxes(range=_view(traces), **place)
    return _styled(figure, rows * ROW_HEIGHT + 90)


def time_split(runs: Sequence[Run]) -> go.Figure | None:
    """Seconds that every run spent in each part of the loop; None if no run logged them."""
    sections = list(dict.fromkeys(name for run in runs for name in run.metrics_of(metrics.TIME)))
    if not sections:
        return None
    parts = {name.partition("/")[2]: [_total(run, name) for run in runs] for name in sections}
    return _stacked([run.label for run in runs], parts, "seconds")


def _stacked(labels: Sequence[str], parts: Mapping[str, Sequence[float]], title: str) -> go.Figure:
    """Horizontal bars, one per label, made of named parts."""
    figure = go.Figure(
        [go.Bar(y=list(labels), x=list(x), name=name, orientation="h") for name, x in parts.items()]
    )
    figure.update_layout(
        barmode="stack", xaxis_title=title, yaxis_autorange="reversed", legend_traceorder="normal"
    )
    return _styled(figure, 160 + 34 * len(labels))


def _styled(figure: go.Figure, height: int) -> go.Figure:
    figure.update_annotations(font_size=14)
    figure.update_layout(
        height=height,
        hovermode="closest",
        template="none",
        legend={
            "orientation": "h",
            "yref": "container",
            "y": 0.995,
            "yanchor": "top",
            "x": 0,
            "xanchor": "left",
        },
        margin={"l": 56, "r": 16, "t": 70, "b": 48},
    )
    return figure


def _view(traces: Sequence[go.Scatter]) -> list[float]:
    """What the vertical axis shows at first: all lines, but not all of a band that few seeds leave wide."""
    lines = np.concatenate([trace.y for trace in traces if trace.fill is None])
    low, high = float(np.nanmin(lines)), float(np.nanmax(lines))
    room = 0.12 * (high - low) or 0.1 * abs(high) or 1.0
    return [low - room, high + room]


def _traces(runs: Sequence[Run], panel: Panel) -> list[go.Scatter]:
    found = [(k, run, run.curve(panel.metric)) for k, run in enumerate(runs)]
    lines = [(k, run, c.scaled(panel.unit).thinned(MAX_POINTS)) for k, run, c in found if c]
    end = max(c.steps[-1] for _, _, c in lines)
    low, high = (bound * panel.unit for bound in panel.bounds)
    traces = [
        trace
        for k, run, c in lines
        for trace in _run_traces(
            run, _to_the_end(c, end), COLOURS[k % len(COLOURS)], lambda x: np.clip(x, low, high)
        )
    ]
    return traces + (_controllers(runs, panel, end) if panel.controller else [])


def _run_traces(
    run: Run, c: Curve, colour: str, clip: Callable[[Floats], Floats]
) -> list[go.Scatter]:
    dash = "dot" if run.config["arm"] == "controller" else "solid"
    meta = {"Run": run.label}
    mean = _line(
        c.steps, c.mean, run.label, run.label, {"color": colour, "width": 2.5, "dash": dash}
    )
    mean.update(meta=meta | {"Show": "mean"}, zorder=1)
    if len(c.seeds) < 2:
        return [mean]
    low, high = map(clip, c.band())
    band = _line(
        np.append(c.steps, c.steps[::-1]), np.append(low, high[::-1]), "", run.label, {"width": 0}
    )
    band.update(
        fill="toself", fillcolor=_transparent(colour, 0.16), hoverinfo="skip", hovertemplate=None
    )
    band.update(meta=meta | {"Show": "95 % band"})
    thin = {"color": _transparent(colour, 0.45), "width": 0.9}
    seeds = [
        _line(
            c.steps,
            values,
            f"{run.label}, seed {seed}",
            run.label,
            thin,
            meta=meta | {"Show": f"seed {seed}"},
        )
        for seed, values in zip(c.seeds, c.values, strict=True)
    ]
    return [mean, band, *seeds]


def _controllers(runs: Sequence[Run], panel: Panel, end: float) -> list[go.Scatter]:
    """The controller's level, once for all runs that it is the same for; reinforcement learning alone has none."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        if run.config["arm"] == "residual" and run.curve(panel.controller):
            groups.setdefault(
                repr([run.config.get(k) for k in ("env", "controller", "disturbance")]), []
            ).append(run)
    traces = []
    for group in groups.values():
        level = max(group, key=lambda run: run.env_steps).curve(panel.controller)
        assert level is not None
        c = _to_the_end(level.scaled(panel.unit), end)
        name = (
            "controller alone"
            if len(groups) == 1
            else f"controller alone ({', '.join(r.label for r in group)})"
        )
        style = {"color": CONTROLLER_COLOUR, "width": 2, "dash": "dash"}
        traces.append(_line(c.steps, c.mean, name, name, style, meta={"Show": "controller"}))
    return traces


def _line(
    x: Floats, y: Floats, name: str, group: str, style: dict[str, Any], **entries: Any
) -> go.Scatter:
    hover = "%{y:.4g} after %{x} steps"
    return go.Scatter(
        x=x,
        y=y,
        name=name,
        legendgroup=group,
        line=style,
        mode="lines",
        hovertemplate=hover,
        **entries,
    )


def _to_the_end(c: Curve, end: float) -> Curve:
    """A single value, as of a controller that learns nothing, is a level: it holds for all steps."""
    if len(c.steps) > 1 or c.steps[0] == end:
        return c
    return Curve(c.seeds, np.array([0.0, end]), np.repeat(c.values, 2, axis=1))


def _transparent(colour: str, alpha: float) -> str:
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{alpha})"


def _total(run: Run, metric: str) -> float:
    c = run.curve(metric)
    return float(c.mean.sum()) if c else 0.0
