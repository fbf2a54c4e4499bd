"""One interactive page about runs side by side; it needs no account, server or network."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from ..loggers import metrics
from ..storage.same_run import SEEDS, leaves, measured_settings
from . import charts, notes, panels, tables
from .page import Page
from .panels import Panel
from .runs import Group, Record, Run, group_runs

OVERVIEW = ("run", "arm", "environment", "algorithm", "disturbance", "seeds", "steps", "directory")
CAPTIONS = {
    "Learning": "Followed episodes during training, scenario {followed}. Thick lines are means "
    "over runs, thin lines runs. Bands are 95 % intervals over runs: of success on "
    "these episodes, otherwise Student's t.",
    "Rescues and regressions": "Share of the followed episodes, paired with the controller alone.",
    "Acceptance": "The tests of candidates: pairs of episodes played, evidence (at 1 the policy is "
    "accepted), and what is left of the error that the run allows.",
    "Controller and residual": "While exploring: how the two share the executed action.",
    "Quantities": "What the environment reports of the followed episodes, scenario {followed}.",
    "Experience": "What the exploring policy meets, per collection.",
    "Real time": "Collection in wall-clock time, per collection: errors of the control period, "
    "time of inference, steps without an answer in time, faults, the acting policy's age in steps.",
    "Interventions": "Share of the training steps that an operator has taken over.",
    "Losses": "Means over the updates of a round.",
    "Budgets": "What using up a budget once costs, in the units of the critics' values, and what "
    "the exploring policy's episodes came to.",
    "Safety limits": "Steps in which a limit changed the action, or something read was not finite.",
}
"""What is said of each section with curves."""
MAX_TITLE = 80
MAX_VIDEO_BYTES = 20_000_000
"""A page with more videos could not be mailed; the rest stay in the run's directory."""


def write_report(runs: Sequence[Run], out: Path) -> Path:
    """Write the page; runs that differ by the seed alone are shown as one.

    Args:
        runs: The runs to show, from ``runs.find_runs``; finished or not.
        out: The HTML file.
    """
    groups = group_runs(runs)
    names = ", ".join(group.label for group in groups)
    page = Page(names if len(names) < MAX_TITLE else f"{len(groups)} groups of runs compared")
    page.section("Runs")
    page.table(OVERVIEW, [_description(group) for group in groups])
    _results(page, groups)
    _curves(page, groups)
    if (figure := charts.time_split(groups)) is not None:
        page.section("Time")
        page.chart(
            figure, "Where the time of a run went, as far as it is logged; mean of the runs."
        )
    _videos(page, groups)
    _configuration(page, groups)
    _versions(page, groups)
    return page.write(out)


def _description(group: Group) -> list[str]:
    """Return a group's row for ``OVERVIEW``."""
    config, total = group.config, group.config["trainer"]["total_steps"]
    done = list(dict.fromkeys(run.env_steps for run in group.runs))
    several = len(group.runs) > 1
    folders = dict.fromkeys(run.path.parent if several else run.path for run in group.runs)
    disturbances = [name for name, node in (config.get("disturbance") or {}).items() if node]
    return [
        group.label,
        config["arm"],
        config["env"]["name"],
        config["algorithm"]["agent"]["_target_"].rpartition(".")[2] if total else "none",
        ", ".join(disturbances) or "none",
        ", ".join(str(run.seed) for run in group.runs),
        str(total) if done == [total] else f"{', '.join(map(str, done))} of {total}",
        ", ".join(map(str, folders)),
    ]


def _results(page: Page, groups: Sequence[Group]) -> None:
    page.section("Final evaluation")
    scenarios = dict.fromkeys(scenario for group in groups for scenario in group.results)
    found = [(s, g) for s in scenarios for g in groups if s in g.results]
    if found:
        header = [tables.COLUMNS[0], "run", *tables.COLUMNS[1:], "each run"]
        page.table(header, [row for s, g in found for row in _success(g, s)])
        for g in (g for g in groups if g.results):
            for note in notes.notes(g.results, g.declared)[1:]:
                page.text(f"{g.label}: {note}" if len(groups) > 1 else note)
        page.text(notes.NOTE)
        declared = panels.agreed(group.declared for group in groups)
        # All scenarios and groups at once: one header for quantities that not all of them have.
        merged = {f"{g.label}\n{s}": g.results[s] for s, g in found}
        header, rows = tables.quantity_rows(merged, declared)
        arms = {group.label: group.config["arm"] for group in groups}
        named = []
        for name, *cells in rows:
            label, scenario = name.split("\n")
            named.append([scenario, label, *_of_arm(arms[label], cells)])
        page.table(["scenario", "run", *header[1:]], named)
        page.text(
            f"Controller alone{tables.ARROW}residual, over the final episodes; mean of the runs. "
            "Of an arm with one of the two, that one."
        )
    for run in (run for group in groups for run in group.runs):
        if not run.results:
            page.text(f"`{run.path}` has no final evaluation yet.")


def _success(group: Group, scenario: str) -> list[list[str]]:
    """The rows of the latest policies and of what is handed over, as in the tables."""
    rows = tables.success_rows({scenario: group.results[scenario]})
    records = [group.results[scenario], list(map(tables.handed_over, group.results[scenario]))]
    return [
        [name, group.label, *_meaningful(group, cells, shown)]
        for (name, *cells), shown in zip(rows, records, strict=False)
    ]


def _meaningful(group: Group, cells: Sequence[str], records: Sequence[Record]) -> list[str]:
    """The cells that mean something: one arm has no residual, another no controller."""
    controller, residual, *changes = cells
    entry, scale = ("success", 100.0) if "success" in records[0]["summary"] else ("return", 1.0)
    each = ", ".join(f"{record['summary'][entry] * scale:.4g}" for record in records)
    if group.config["arm"] == "controller":
        return [controller, "", *("" for _ in changes), ""]
    alone = group.config["arm"] == "rl"
    return ["" if alone else controller, residual, *("" if alone else c for c in changes), each]


def _of_arm(arm: str, cells: Sequence[str]) -> list[str]:
    """The cells ``controller -> residual`` with what the arm has of the two."""
    part = {"controller": slice(0, 1), "rl": slice(-1, None)}.get(arm, slice(None))
    return [tables.ARROW.join(cell.split(tables.ARROW)[part]) for cell in cells]


def _curves(page: Page, groups: Sequence[Group]) -> None:
    followed = ", ".join(dict.fromkeys(group.followed for group in groups))
    missing = []
    for title, shown in _sections(groups).items():
        figure = charts.curves(groups, shown)
        if figure is None:
            missing.append(title.lower())
            continue
        page.section(title)
        page.chart(figure, CAPTIONS[title].format(followed=followed))
    if missing:
        page.text(f"Nothing was logged for: {', '.join(missing)}.")


def _sections(groups: Sequence[Group]) -> dict[str, Sequence[Panel]]:
    """Return the panels of every section with curves."""

    def names_of(group: str) -> list[str]:
        names = dict.fromkeys(n for g in groups for n in g.metrics_of(group))
        return [metrics.name(group, name) for name in names]

    def panels_of(group: str) -> list[Panel]:
        return panels.logged(names_of(group))

    entries = dict.fromkeys(n for g in groups for n in g.metrics_of(metrics.EVALUATION, g.followed))
    declared = panels.agreed(group.declared for group in groups)
    limits = dict.fromkeys(n for g in groups for n in g.metrics_of(metrics.SAFETY))
    return {
        "Learning": panels.LEARNING,
        "Rescues and regressions": panels.CHANGES,
        "Acceptance": panels_of(metrics.ACCEPTANCE),
        "Controller and residual": panels.SHARES,
        "Quantities": [*panels.quantities(entries, declared), panels.LENGTH],
        "Experience": panels_of(metrics.TRAIN),
        "Real time": panels_of(metrics.REALTIME),
        "Interventions": panels_of(metrics.INTERVENTION),
        "Losses": panels_of(metrics.LOSS),
        "Budgets": panels.budgets(names_of(metrics.CONSTRAINT), declared),
        "Safety limits": panels.safety(limits),
    }


def _videos(page: Page, groups: Sequence[Group]) -> None:
    videos = [(shown, video) for group in groups for shown, video in group.videos]
    if videos:
        page.section("Videos")
    size = 0
    for shown, video in videos:
        more = video.stat().st_size
        if size + more <= MAX_VIDEO_BYTES:
            size += more
            page.video(video, f"{shown}: {video.stem.replace('_', ' ')}")
        else:
            page.text(f"Left out to keep the page small: `{video}`.")


def _configuration(page: Page, groups: Sequence[Group]) -> None:
    page.section("Configuration")
    if len(groups) > 1:
        page.text("What differs, beside the seeds:")
        columns = [leaves(group.config) for group in groups]
        counted = set().union(*(measured_settings(group.config, SEEDS) for group in groups))
        rows = [
            [key, *(_plain(column.get(key, "")) for column in columns)]
            for key in sorted(counted)
            if len({column.get(key, "") for column in columns}) > 1
        ]
        page.table(["key", *(group.label for group in groups)], rows)
    for group in groups:
        text = yaml.safe_dump(group.config, sort_keys=False)
        page.details(f"Whole configuration of {group.label}, seed {group.runs[0].seed}", text)


def _versions(page: Page, groups: Sequence[Group]) -> None:
    page.section("Versions")
    packages = dict.fromkeys(name for g in groups for run in g.runs for name in run.versions)
    rows = [[package, *(_version(group, package) for group in groups)] for package in packages]
    if rows:
        page.table(["", *(group.label for group in groups)], rows)
    else:
        page.text("Not recorded by these runs.")


def _version(group: Group, package: str) -> str:
    return ", ".join(dict.fromkeys(run.versions.get(package, "unknown") for run in group.runs))


def _plain(value: str) -> Any:
    """JSON text without the quotes of a string."""
    loaded = json.loads(value) if value else ""
    return loaded if isinstance(loaded, str) else value
