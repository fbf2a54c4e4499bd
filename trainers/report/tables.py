"""Tables of final evaluations: controller against residual, scenario by scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Group as Blocks
from rich.table import Table

from rrl.keys import METRICS

from ..evaluation.statistics import mean_interval, paired_interval, success_interval, wilson
from .panels import quantity_title
from .runs import Record

if TYPE_CHECKING:  # without torch a report of finished runs is quick
    from ..evaluation.episodes import Comparison

__all__ = [
    "COLUMNS",
    "EPISODE_COLUMNS",
    "NOTE",
    "Results",
    "episode_rows",
    "markdown_tables",
    "one_run",
    "quantity_rows",
    "success_cells",
    "success_rows",
    "terminal_tables",
    "with_interval",
]

Results = Mapping[str, Sequence[Record]]
"""Scenario to the records of the runs that are shown as one."""

COLUMNS = ("scenario", "controller", "residual", "gain", "rescued", "broken")
EPISODE_COLUMNS = ("scenario", "episode", "outcome", "entry", "controller", "residual")
NOTE = (
    "Brackets hold 95 % intervals. Controller, and residual of one run: Wilson's, over its "
    "episodes. Residual of several runs: the success rate of runs like these, beta-binomial, or "
    "Student's t of the return. Gain: paired on the same frozen episodes. Rescued and broken: "
    "episodes that only the residual or only the controller solves, mean of the runs."
)
OUTCOMES: Mapping[tuple[bool, ...], str] = {
    (False, True): "rescued",
    (True, False): "broken",
    (True, True): "both",
    (False, False): "neither",
}
"""What became of an episode, by the controller's and the residual's success."""
BASIC = {
    "return": "return",
    "episode_length": "control steps",
    "diverged": "physics diverged [share]",
}


def one_run(results: Mapping[str, Comparison]) -> dict[str, list[Record]]:
    """Return the results of one run as the tables take them."""
    return {scenario: [comparison.record()] for scenario, comparison in results.items()}


def success_rows(results: Results) -> list[list[str]]:
    """Return one row of text for every scenario, for ``COLUMNS``."""
    return [[scenario, *success_cells(records)] for scenario, records in results.items()]


def success_cells(records: Sequence[Record]) -> list[str]:
    """Return a scenario's row after its name; returns stand in where there is no success."""
    episodes = [record["episodes"] for record in records]
    entry = "success" if "success" in episodes[0] else "return"
    values = np.array([e[entry] for e in episodes], dtype=float)  # (S, N)
    alone = np.array([e[f"controller_{entry}"] for e in episodes], dtype=float)
    if entry == "return":
        gain = paired_interval(values - alone)
        return [
            f"{alone[0].mean():.2f}",
            with_interval(values.mean(), mean_interval(values.mean(axis=1))),
            with_interval((values - alone).mean(), gain, sign="+"),
            "",
            "",
        ]
    count = values.shape[1]
    solved, low_high = values.sum(axis=1), paired_interval(values - alone, bound=1.0)
    changes = [np.mean([r["summary"][key] for r in records]) for key in ("rescues", "regressions")]
    return [
        with_interval(alone[0].mean(), wilson(int(alone[0].sum()), count), 100.0),
        with_interval(values.mean(), success_interval(solved.tolist(), count), 100.0),
        with_interval((values - alone).mean(), low_high, 100.0, sign="+"),
        *(f"{change:.1f}".removesuffix(".0") for change in changes),
    ]


def with_interval(
    value: float, interval: tuple[float, float], scale: float = 1.0, sign: str = "-"
) -> str:
    """Format a value and its interval; bounds are rounded outwards. A scale of 100 means per cent.

    An interval that is not a number, as of a single run, is left out.
    """
    digits, percent = (1, " %") if scale == 100.0 else (2, "")
    text = f"{value * scale:{sign}.{digits}f}"
    if math.isnan(interval[0]):
        return f"{text}{percent} (one run)"
    unit = 10**digits
    low = math.floor(interval[0] * scale * unit + 1e-9) / unit
    high = math.ceil(interval[1] * scale * unit - 1e-9) / unit
    return f"{text} [{low:{sign}.{digits}f}, {high:{sign}.{digits}f}]{percent}"


def quantity_rows(
    results: Results, units: Mapping[str, str], everything: bool = True
) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of all other quantities, ``controller -> residual``.

    Args:
        results: What to show.
        units: Units of what the environment reports, by name.
        everything: Also what every environment has: return, length, divergence.
    """
    known = dict.fromkeys(key for records in results.values() for key in records[0]["summary"])
    titles = {key: BASIC[key] for key in BASIC if everything and key in known}
    titles |= {k: quantity_title(k, dict(units)) for k in known if k.startswith(f"{METRICS}/")}
    rows = []
    for scenario, records in results.items():
        summaries = [record["summary"] for record in records]
        cells = [
            " \u2192 ".join(f"{np.mean([s[k] for s in summaries]):.2f}" for k in pair)
            if pair[0] in summaries[0]
            else ""
            for pair in ((f"controller_{key}", key) for key in titles)
        ]
        rows.append([scenario, *cells])
    return ["scenario", *titles.values()], rows


def episode_rows(results: Results) -> list[list[Any]]:
    """Return one row for every scenario, run, episode and entry, for ``EPISODE_COLUMNS``."""
    return [
        [scenario, *row]
        for scenario, records in results.items()
        for record in records
        for row in _episodes(record["episodes"])
    ]


def _episodes(episodes: Mapping[str, Sequence[Any]]) -> Iterator[list[Any]]:
    entries = [key for key in episodes if f"controller_{key}" in episodes]
    for i in range(len(episodes["return"])):
        solved = [bool(episodes[k][i]) for k in ("controller_success", "success") if k in episodes]
        for key in entries:
            pair = float(episodes[f"controller_{key}"][i]), float(episodes[key][i])
            yield [i, OUTCOMES.get(tuple(solved)), key, *pair]


def terminal_tables(results: Results, units: Mapping[str, str], title: str) -> Blocks:
    """Return the tables for the terminal."""
    count = len(next(iter(results.values()))[0]["episodes"]["return"])
    tables = [Table(*COLUMNS, title=title, title_justify="left")]
    for row in success_rows(results):
        tables[0].add_row(*row)
    header, rows = quantity_rows(results, units, everything=False)
    if len(header) > 1:
        tables.append(Table(*header))
        for row in rows:
            tables[1].add_row(*row)
    return Blocks(*tables, f"{count} final episodes a scenario. {NOTE}")


def markdown_tables(results: Results, units: Mapping[str, str]) -> str:
    """Return the tables for a README."""
    blocks = []
    for header, rows in ((COLUMNS, success_rows(results)), quantity_rows(results, units)):
        lines = ["| " + " | ".join(row) + " |" for row in (header, *rows)]
        blocks.append("\n".join([lines[0], "|" + "---|" * len(header), *lines[1:]]))
    return "\n\n".join([*blocks, NOTE, ""])
