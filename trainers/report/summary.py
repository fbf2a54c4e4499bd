"""The table that ends a run: controller against residual, scenario by scenario."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from rich.table import Table

from ..evaluation.statistics import mean_interval
from ..storage.files import write_atomically

if TYPE_CHECKING:  # it needs torch, and a report of finished runs does not
    from ..evaluation.episodes import Comparison

Results: TypeAlias = "Mapping[str, Sequence[Comparison]]"
"""Scenario to one comparison per seed."""

COLUMNS = (
    "scenario",
    "controller",
    "residual, mean of seeds [95 % CI]",
    "residual, each seed",
    "rescued",
    "broken",
)

EPISODE_COLUMNS = (
    "scenario",
    "seed",
    "episode",
    "outcome",
    "controller_success",
    "residual_success",
    "controller_return",
    "residual_return",
    "controller_contact_force",
    "residual_contact_force",
)
OUTCOMES: Mapping[tuple[bool | None, ...], str] = {
    (False, True): "rescued",
    (True, False): "broken",
    (True, True): "both",
    (False, False): "neither",
}
"""What became of an episode, by the controller's and the residual's success."""


def rows(results: Results, seeds: Sequence[int]) -> list[list[str]]:
    """One row of text per scenario, for ``COLUMNS``; returns stand in where the environment knows no success."""
    summaries = {
        name: [c.summary() for c in comparisons]
        for name, comparisons in results.items()
        if comparisons
    }
    return [[name, *cells(of_seeds)] for name, of_seeds in summaries.items()]


def cells(summaries: Sequence[Mapping[str, float]]) -> list[str]:
    """One scenario's row after its name, from one comparison's summary per seed."""
    if "success" not in summaries[0]:
        returns = [s["return"] for s in summaries]
        each = ", ".join(f"{r:.2f}" for r in returns)
        return [
            f"{summaries[0]['controller_return']:.2f}",
            _mean_text(returns, "{:.2f}", (-np.inf, np.inf)),
            each,
            "",
            "",
        ]
    rates = [s["success"] for s in summaries]
    solved, low, high = (summaries[0][f"controller_success{end}"] for end in ("", "_low", "_high"))
    return [
        f"{solved:.0%} [{low:.0%}, {high:.0%}]",
        _mean_text(rates, "{:.1%}", (0.0, 1.0)),
        ", ".join(f"{rate:.0%}" for rate in rates),
        f"{np.mean([s['rescues'] for s in summaries]):.1f}",
        f"{np.mean([s['regressions'] for s in summaries]):.1f}",
    ]


def episode_rows(results: Results, seeds: Sequence[int]) -> list[list[Any]]:
    """One row per scenario, seed and episode, for ``EPISODE_COLUMNS``; None where the environment does not say."""
    return [
        [scenario, seed, episode, *cells_of_episode]
        for scenario, comparisons in results.items()
        for seed, comparison in zip(seeds, comparisons, strict=True)
        for episode, cells_of_episode in enumerate(_episodes(comparison))
    ]


def _episodes(comparison: Comparison) -> Iterator[list[Any]]:
    pair = comparison.controller, comparison.residual
    for i in range(len(comparison.residual.returns)):
        solved = [None if e.success is None else bool(e.success[i]) for e in pair]
        forces = [
            float(e.peaks["contact_force"][i]) if "contact_force" in e.peaks else None for e in pair
        ]
        yield [OUTCOMES.get(tuple(solved)), *solved, *(float(e.returns[i]) for e in pair), *forces]


def _mean_text(values: Sequence[float], form: str, bounds: tuple[float, float]) -> str:
    text = form.format(np.mean(values))
    if len(values) < 2:
        return text
    low, high = (float(np.clip(bound, *bounds)) for bound in mean_interval(values))
    return f"{text} [{form.format(low)}, {form.format(high)}]"


def terminal_table(results: Results, seeds: Sequence[int], title: str) -> Table:
    """The table for the terminal."""
    table = Table(title=title, title_justify="left", caption=caption(results, seeds))
    for column in COLUMNS:
        table.add_column(column)
    for row in rows(results, seeds):
        table.add_row(*row)
    return table


def markdown_table(results: Results, seeds: Sequence[int]) -> str:
    """The table for a README."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    lines += ["| " + " | ".join(row) + " |" for row in rows(results, seeds)]
    return "\n".join([*lines, "", caption(results, seeds), ""])


def caption(results: Results, seeds: Sequence[int]) -> str:
    """What the numbers are: episodes, seeds, intervals."""
    episodes = len(next(iter(results.values()))[0].residual.returns)
    return (
        f"{episodes} frozen episodes a scenario, the same for all; seeds {', '.join(map(str, seeds))}. "
        "Controller: Wilson's 95 % interval. Residual: Student's t interval of the mean over seeds. "
        "Rescued and broken: episodes that only the residual or only the controller solves, mean of seeds."
    )


def write_results(results: Results, seeds: Sequence[int], path: Path) -> None:
    """Write every summary of every seed as JSON, all or nothing."""
    content = {
        scenario: {
            str(seed): comparison.summary()
            for seed, comparison in zip(seeds, comparisons, strict=True)
        }
        for scenario, comparisons in results.items()
    }
    write_atomically(path, json.dumps(content, indent=2) + "\n")
