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
from ..metric_names import ACCEPTED, CONTROLLER, FAULTS, decimals, is_share
from .curves import Floats
from .markdown import markdown_table
from .notes import Results, is_frozen, notes
from .panels import Declared, quantity_title
from .runs import Record, Run

if TYPE_CHECKING:  # without torch a report of finished runs is quick
    from ..evaluation.episodes import Comparison

COLUMNS = ("scenario", "controller", "residual", "gain", "rescued", "broken")
EPISODE_COLUMNS = ("scenario", "episode", "outcome", "entry", "controller", "residual")
HANDED_OVER = ", handed over"
ARROW = " \u2192 "
"""From the controller's mean of a quantity to the policy's."""
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
    FAULTS: "robot faults",
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


def rescued(record: Record) -> list[int]:
    """Return the episodes that the controller fails and the policy solves; none if unpaired.

    Of a record from :func:`handed_over` they are those of the policy that the run hands over.
    """
    episodes = record["episodes"]
    pairs = zip(episodes.get("controller_success", ()), episodes.get("success", ()), strict=True)
    found = [i for i, (alone, helped) in enumerate(pairs) if helped and not alone]
    return found if is_frozen(record) else []


def most_rescued(runs: Sequence[Run]) -> tuple[Run, list[int]]:
    """Return the run that rescues the most final episodes of the followed scenario, and these."""
    found = {run: rescued(handed_over(run.results[run.followed])) for run in runs}
    run = max(found, key=lambda run: len(found[run]))
    return run, found[run]


def success_rows(results: Results) -> list[list[str]]:
    """Return rows of text for ``COLUMNS``: one for every scenario, for the latest policies.

    A second row is of what is handed over, where that is another policy in any of the runs.
    """
    return [[name, *success_cells(records)] for name, records in _by_policy(results)]


def _by_policy(results: Results) -> Iterator[tuple[str, Sequence[Record]]]:
    """Each scenario's records, then those of what is handed over, where that is another policy."""
    for scenario, records in results.items():
        yield scenario, records
        accepted = [handed_over(record) for record in records]
        entries = [(a["episodes"], r["episodes"]) for a, r in zip(accepted, records, strict=True)]
        if any(a[key] != latest[key] for a, latest in entries for key in a):
            yield scenario + HANDED_OVER, accepted


def success_cells(records: Sequence[Record]) -> list[str]:
    """Return a scenario's row after its name; returns stand in where there is no success."""
    entry, values, alone = _compared(records)
    frozen = all(map(is_frozen, records))
    change, interval = gain(records)
    alone = alone[:1] if frozen else alone  # frozen, it is the same in every run
    if entry == "return":
        return [
            with_interval(alone.mean(), mean_interval(alone.ravel())),
            with_interval(values.mean(), mean_interval(values.mean(axis=1))),
            with_interval(change, interval, sign="+"),
            "",
            "",
        ]
    return [
        with_interval(alone.mean(), wilson(int(alone.sum()), alone.size), 100.0),
        with_interval(values.mean(), success_interval(values), 100.0),
        with_interval(change, interval, 100.0, sign="+"),
        *(_mean_change(records, key) if frozen else "" for key in ("rescues", "regressions")),
    ]


def gain(records: Sequence[Record]) -> tuple[float, Interval]:
    """Return by how much the policies beat the controller, with its interval.

    In success rate, or in return where there is no success; paired where episodes are frozen.
    """
    entry, values, alone = _compared(records)
    bound = 1.0 if entry == "success" else None
    difference = float(values.mean() - alone.mean())
    if all(map(is_frozen, records)):
        return difference, paired_interval(values - alone, bound=bound)
    return difference, unpaired_interval(values, alone, bound)


def _compared(records: Sequence[Record]) -> tuple[str, Floats, Floats]:
    """What is compared, and its values ``[S, N]`` by run: the policies', the controller's."""
    episodes = [record["episodes"] for record in records]
    entry = "success" if "success" in episodes[0] else "return"
    values = np.array([e[entry] for e in episodes], dtype=float)
    return entry, values, np.array([e[CONTROLLER + entry] for e in episodes], dtype=float)


def _mean_change(records: Sequence[Record], key: str) -> str:
    return f"{np.mean([record['summary'][key] for record in records]):.1f}".removesuffix(".0")


def number(value: float, scale: float = 1.0) -> str:
    """Format a value; a scale of 100 means per cent."""
    if scale == 100.0:
        return f"{value * scale:.1f} %"
    return f"{value * scale:.{decimals(value * scale)}f}"


def with_interval(
    value: float, interval: tuple[float, float], scale: float = 1.0, sign: str = "-"
) -> str:
    """Format a value and its interval, or that it has none. A scale of 100 means per cent.

    Two digits of the largest of the numbers are shown, however small they are.
    """
    digits, percent = (1, " %") if scale == 100.0 else (decimals(value, *interval), "")
    text = f"{value * scale:{sign}.{digits}f}"
    if math.isnan(interval[0]):
        return f"{text}{percent}{' (no interval)' if math.isfinite(value) else ''}"
    return f"{text} {brackets(interval, f'{sign}.{digits}f', scale)}{percent}"


def brackets(interval: Interval, form: str, scale: float = 1.0, unit: str = "") -> str:
    """Format an interval; its bounds are rounded outwards, so that it keeps a width.

    Args:
        interval: Its bounds.
        form: Of a bound, with its decimals at the end: ``.1f``.
        scale: Of the bounds.
        unit: Behind either bound.
    """
    step = 10 ** int(form.rpartition(".")[2].removesuffix("f"))
    low = np.floor(interval[0] * scale * step + 1e-9) / step + 0.0  # no zero with a sign
    high = np.ceil(interval[1] * scale * step - 1e-9) / step + 0.0
    return f"[{low:{form}}{unit}, {high:{form}}{unit}]"


def quantity_rows(
    results: Results, declared: Declared, everything: bool = True
) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of all other quantities, ``controller -> residual``.

    As in :func:`success_rows` a second row is of what is handed over.

    Args:
        results: What to show.
        declared: What the environment says of its quantities.
        everything: Also what every environment has: return, length, divergence.
    """
    known = dict.fromkeys(key for records in results.values() for key in records[0]["summary"])
    titles = {key: BASIC[key] for key in BASIC if everything and key in known}
    reported = [key for key in known if key.startswith(f"{METRICS}/")]
    titles |= {key: quantity_title(key, declared) for key in reported}
    rows = []
    for name, records in _by_policy(results):
        summaries = [record["summary"] for record in records]
        rows.append([name, *(_from_controller(summaries, key) for key in titles)])
    return ["scenario", *titles.values()], rows


def _from_controller(summaries: Sequence[Mapping[str, Any]], key: str) -> str:
    """The means of an entry over runs, the controller's first; of a share in per cent."""
    if CONTROLLER + key not in summaries[0]:
        return ""
    pair = [
        float(np.mean([summary.get(name, math.nan) for summary in summaries]))
        for name in (CONTROLLER + key, key)
    ]
    if is_share(key):
        return ARROW.join(f"{100 * mean:.1f}" for mean in pair)
    return ARROW.join(f"{mean:.{decimals(*pair)}f}" for mean in pair)


def episode_rows(results: Results) -> list[list[Any]]:
    """Return one row for every scenario, run, episode and entry, for ``EPISODE_COLUMNS``."""
    return [
        [scenario, *row]
        for scenario, records in results.items()
        for record in records
        for row in _episodes(record["episodes"], is_frozen(record))
    ]


def _episodes(episodes: Mapping[str, Sequence[Any]], frozen: bool) -> Iterator[list[Any]]:
    keys = (f"{CONTROLLER}success", "success")
    entries = [key for key in episodes if CONTROLLER + key in episodes]
    for i in range(len(episodes["return"])):
        solved = tuple(bool(episodes[k][i]) for k in keys if k in episodes) if frozen else ()
        for key in entries:
            pair = float(episodes[CONTROLLER + key][i]), float(episodes[key][i])
            yield [i, OUTCOMES.get(solved), key, *pair]


def terminal_tables(results: Results, declared: Declared, title: str) -> Blocks:
    """Return the tables for the terminal."""
    count = len(next(iter(results.values()))[0]["episodes"]["return"])
    tables = [Table(*COLUMNS, title=title, title_justify="left")]
    for row in success_rows(results):
        tables[0].add_row(*row)
    header, rows = quantity_rows(results, declared, everything=False)
    if len(header) > 1:
        tables.append(Table(*header))
        for row in rows:
            tables[1].add_row(*row)
    return Blocks(
        *tables, f"{count} final episodes a scenario. {' '.join(notes(results, declared))}"
    )


def markdown_tables(results: Results, declared: Declared) -> str:
    """Return the tables for a README."""
    both = (COLUMNS, success_rows(results)), quantity_rows(results, declared)
    tables = [markdown_table(header, rows) for header, rows in both]
    return "\n\n".join([*tables, *notes(results, declared), ""])
