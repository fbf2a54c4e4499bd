"""Tables of final evaluations: controller against residual, scenario by scenario."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Group as Blocks
from rich.table import Table

from rrl.keys import METRICS

from ..evaluation.statistics import (
    Interval,
    mean_interval,
    paired_interval,
    success_interval,
    unpaired_interval,
    wilson,
)
from .curves import Floats
from .panels import quantity_title
from .runs import Record

if TYPE_CHECKING:  # without torch a report of finished runs is quick
    from ..evaluation.episodes import Comparison

__all__ = [
    "ACCEPTED",
    "COLUMNS",
    "EPISODE_COLUMNS",
    "Results",
    "episode_rows",
    "gain",
    "handed_over",
    "markdown_tables",
    "notes",
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
UNPAIRED = (
    "The episodes of {} are not frozen: played twice they came out differently. Controller and "
    "residual are independent samples there; the gain has the interval of these, and no episode is "
    "called rescued or broken."
)
ACCEPTED = "accepted_"
HANDED_OVER = ", handed over"
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


def handed_over(record: Record) -> Record:
    """Return a scenario's record with what the run hands over in the latest policy's place."""

    def exchanged(part: Mapping[str, Any]) -> dict[str, Any]:
        accepted = {k.removeprefix(ACCEPTED): v for k, v in part.items() if k.startswith(ACCEPTED)}
        return {k: v for k, v in part.items() if not k.startswith(ACCEPTED)} | accepted

    return {name: exchanged(part) for name, part in record.items()}


def success_rows(results: Results) -> list[list[str]]:
    """Return rows of text for ``COLUMNS``: one for every scenario, for the latest policies.

    A second row is of what is handed over, where that is another policy in any of the runs.
    """
    rows = []
    for scenario, records in results.items():
        rows.append([scenario, *success_cells(records)])
        accepted = [handed_over(record) for record in records]
        entries = [(a["episodes"], r["episodes"]) for a, r in zip(accepted, records, strict=True)]
        if any(a[key] != latest[key] for a, latest in entries for key in a):
            rows.append([scenario + HANDED_OVER, *success_cells(accepted)])
    return rows


def success_cells(records: Sequence[Record]) -> list[str]:
    """Return a scenario's row after its name; returns stand in where there is no success."""
    entry, values, alone = _compared(records)
    frozen = all(map(_frozen, records))
    change, interval = gain(records)
    alone = alone[:1] if frozen else alone  # frozen, it is the same in every run
    if entry == "return":
        return [
            f"{alone.mean():.2f}",
            with_interval(values.mean(), mean_interval(values.mean(axis=1))),
            with_interval(change, interval, sign="+"),
            "",
            "",
        ]
    count = values.shape[1]
    return [
        with_interval(alone.mean(), wilson(int(alone.sum()), alone.size), 100.0),
        with_interval(values.mean(), success_interval(values.sum(axis=1).tolist(), count), 100.0),
        with_interval(change, interval, 100.0, sign="+"),
        *(_mean_change(records, key) if frozen else "" for key in ("rescues", "regressions")),
    ]


def gain(records: Sequence[Record]) -> tuple[float, Interval]:
    """Return by how much the policies beat the controller, with its interval.

    In success rate, or in return where there is no success; paired where episodes are frozen.
    """
    entry, values, alone = _compared(records)
    bound = 1.0 if entry == "success" else None
    frozen = all(map(_frozen, records))
    interval = (
        paired_interval(values - alone, bound)
        if frozen
        else unpaired_interval(values, alone, bound)
    )
    return float(values.mean() - alone.mean()), interval


def _compared(records: Sequence[Record]) -> tuple[str, Floats, Floats]:
    """What is compared, and its values ``[S, N]`` by run: the policies', the controller's."""
    episodes = [record["episodes"] for record in records]
    entry = "success" if "success" in episodes[0] else "return"
    values = np.array([e[entry] for e in episodes], dtype=float)
    return entry, values, np.array([e[f"controller_{entry}"] for e in episodes], dtype=float)


def _mean_change(records: Sequence[Record], key: str) -> str:
    return f"{np.mean([record['summary'][key] for record in records]):.1f}".removesuffix(".0")


def _frozen(record: Record) -> bool:
    return bool(record["summary"].get("frozen", True))


def notes(results: Results) -> list[str]:
    """Return how the tables are to be read, and what the runs hand over."""
    found = [NOTE]
    loose = [name for name, records in results.items() if not all(map(_frozen, records))]
    if loose:
        found.append(UNPAIRED.format(", ".join(loose)))
    records = next(iter(results.values()), ())
    steps = [r["summary"].get(f"{ACCEPTED}env_steps") for r in records]
    tested = [int(step) for step in steps if step is not None]
    if tested:
        found.append(_what_is_handed_over(tested))
    return found


def _what_is_handed_over(steps: Sequence[int]) -> str:
    """Say what the runs hand over; 0 steps stand for the controller."""
    learned = [step for step in steps if step]
    if len(steps) > 1:
        return (
            f"Handed over: a learned policy by {len(learned)} of {len(steps)} runs, the controller "
            "alone by the others, in which no policy passed the test against it."
        )
    if not learned:
        return (
            "Handed over: the controller alone. No policy passed the test that it is not worse "
            "than the controller."
        )
    return (
        f"Handed over: the policy after {learned[0]} environment steps, which passed the test that "
        "it is not worse than the controller."
    )


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
        for row in _episodes(record["episodes"], _frozen(record))
    ]


def _episodes(episodes: Mapping[str, Sequence[Any]], frozen: bool) -> Iterator[list[Any]]:
    keys = ("controller_success", "success")
    entries = [key for key in episodes if f"controller_{key}" in episodes]
    for i in range(len(episodes["return"])):
        solved = tuple(bool(episodes[k][i]) for k in keys if k in episodes) if frozen else ()
        for key in entries:
            pair = float(episodes[f"controller_{key}"][i]), float(episodes[key][i])
            yield [i, OUTCOMES.get(solved), key, *pair]


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
    return Blocks(*tables, f"{count} final episodes a scenario. {' '.join(notes(results))}")


def markdown_tables(results: Results, units: Mapping[str, str]) -> str:
    """Return the tables for a README."""
    blocks = []
    for header, rows in ((COLUMNS, success_rows(results)), quantity_rows(results, units)):
        lines = ["| " + " | ".join(row) + " |" for row in (header, *rows)]
        blocks.append("\n".join([lines[0], "|" + "---|" * len(header), *lines[1:]]))
    return "\n\n".join([*blocks, *notes(results), ""])
