"""One interactive page about one run, or about several side by side; it needs no account, server or network."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from ..loggers import metrics
from ..storage.same_run import leaves
from . import charts
from .page import Page
from .panels import CHANGES, CONTACT, FOLLOWED, LEARNING, RATE, SHARES, Panel
from .runs import Run
from .summary import COLUMNS, cells

MAX_TITLE = 80
MAX_VIDEO_BYTES = 20_000_000
"""A page of all videos larger than this could not be mailed; the rest stay in the run's directory."""

QUANTITIES = {
    "return": "return of an episode",
    "episode_length": "control steps",
    "peak_contact_force": "largest contact force [N]",
    "peak_tilt": "largest tilt [rad]",
    "diverged": "physics diverged [share]",
}
"""Entries of a comparison's summary that say what success costs."""


def write_report(runs: Sequence[Run], out: Path) -> Path:
    """Write the page.

    Args:
        runs: the runs to show, from ``runs.find_runs``; finished or not.
        out: the HTML file.
    """
    names = ", ".join(run.label for run in runs)
    page = Page(names if len(names) < MAX_TITLE else f"{len(runs)} runs compared")
    _overview(page, runs)
    _results(page, runs)
    _curves(page, runs)
    _time(page, runs)
    _videos(page, runs)
    _configuration(page, runs)
    _versions(page, runs)
    return page.write(out)


def _overview(page: Page, runs: Sequence[Run]) -> None:
    page.section("Runs")
    header = [
        "run",
        "arm",
        "environment",
        "algorithm",
        "disturbance",
        "seeds",
        "steps",
        "directory",
    ]
    page.table(header, [_description(run) for run in runs])


def _description(run: Run) -> list[str]:
    config = run.config
    total = config["trainer"]["total_steps"]
    steps = f"{run.env_steps} of {total}" if run.env_steps < total else str(total)
    disturbances = [name for name, node in (config.get("disturbance") or {}).items() if node]
    learner = config["algorithm"]["agent"]["_target_"].rpartition(".")[2] if total else "none"
    seeds = ", ".join(map(str, run.seeds))
    disturbed = ", ".join(disturbances) or "none"
    return [
        run.label,
        config["arm"],
        config["env"]["name"],
        learner,
        disturbed,
        seeds,
        steps,
        str(run.path),
    ]


def _results(page: Page, runs: Sequence[Run]) -> None:
    page.section("Final evaluation")
    finished = [
        (scenario, run, list(run.results[scenario].values()))
        for scenario in dict.fromkeys(scenario for run in runs for scenario in run.results)
        for run in runs
        if run.results.get(scenario)
    ]
    if finished:
        rows = [[scenario, run.label, *_success(run, seeds)] for scenario, run, seeds in finished]
        page.table(["scenario", "run", *COLUMNS[1:]], rows)
        page.text(
            "Frozen episodes without exploration, the same for the controller alone and for every seed and run. "
            "Controller: Wilson's 95 % interval. Residual: Student's t interval of the mean over seeds. Rescued and "
            "broken: episodes that only the residual or only the controller solves, mean of seeds."
        )
        entries = [e for e in QUANTITIES if any(e in seeds[0] for _, _, seeds in finished)]
        rows = [
            [name, run.label, *(_quantity(seeds, entry) for entry in entries)]
            for name, run, seeds in finished
        ]
        page.table(["scenario", "run", *(QUANTITIES[entry] for entry in entries)], rows)
        page.text(
            "The controller's mean over the episodes, and the residual's, which is also the mean of seeds."
        )
    for run in runs:
        if not run.results:
            page.text(f"`{run.label}` has no final evaluation yet.")


def _success(run: Run, seeds: Sequence[Mapping[str, float]]) -> list[str]:
    """The cells that mean something: one arm has no residual, another no controller to compare with."""
    controller, mean, each, *changes = cells(seeds)
    if run.config["arm"] == "controller":
        return [controller, *("" for _ in (mean, each, *changes))]
    return (
        ["", mean, each, *("" for _ in changes)]
        if run.config["arm"] == "rl"
        else [controller, mean, each, *changes]
    )


def _quantity(seeds: Sequence[Mapping[str, float]], entry: str) -> str:
    if entry not in seeds[0]:
        return ""
    return f"{seeds[0][f'controller_{entry}']:.2f} \u2192 {sum(s[entry] for s in seeds) / len(seeds):.2f}"


def _curves(page: Page, runs: Sequence[Run]) -> None:
    followed = ", ".join(dict.fromkeys(run.followed for run in runs))
    band = (
        "Thick lines are means over seeds, bands the mean's 95 % confidence interval (Student's t), thin lines seeds. "
        "The last point of a finished run is its final evaluation, which may have more episodes than those before."
    )
    sections = (
        (
            "Learning",
            LEARNING,
            f"Evaluation on frozen episodes during training, scenario {followed}. {band}",
        ),
        (
            "Rescues and regressions",
            CHANGES,
            "Share of the evaluation's episodes, paired with the controller alone.",
        ),
        (
            "Controller and residual",
            SHARES,
            "While exploring: how the two share the executed action.",
        ),
        ("Contact", CONTACT, f"Means over the evaluation's episodes, scenario {followed}."),
        (
            "Experience",
            _panels(runs, metrics.TRAIN),
            "What the exploring policy meets, per collection.",
        ),
        ("Losses", _panels(runs, metrics.LOSS), "Means over the updates of a round."),
        ("Safety limits", _safety(runs), "Steps in which a limit changed the action."),
    )
    missing = []
    for title, panels, caption in sections:
        figure = charts.curves(runs, panels)
        if figure is None:
            missing.append(title.lower())
            continue
        page.section(title)
        page.chart(figure, caption)
    if missing:
        page.text(f"Nothing was logged for: {', '.join(missing)}.")


def _panels(runs: Sequence[Run], group: str) -> list[Panel]:
    """A panel for every metric of a group."""
    names = dict.fromkeys(name for run in runs for name in run.metrics_of(group))
    return [
        Panel(name, name.partition("/")[2].replace("/", ": ").replace("_", " ")) for name in names
    ]


def _safety(runs: Sequence[Run]) -> list[Panel]:
    limits = dict.fromkeys(
        name.partition("/")[2] for run in runs for name in run.metrics_of(metrics.SAFETY)
    )
    kinds = (
        ("training", f"{metrics.SAFETY}/"),
        ("evaluation", f"{metrics.EVALUATION}/{FOLLOWED}/{metrics.SAFETY}_"),
    )
    return [
        Panel(prefix + limit, f"{limit}, {kind} [%]", 100.0, RATE)
        for limit in limits
        for kind, prefix in kinds
    ]


def _time(page: Page, runs: Sequence[Run]) -> None:
    figure = charts.time_split(runs)
    if figure is not None:
        page.section("Time")
        page.chart(
            figure,
            "Where the time of all seeds together went, summed over what is logged of the run.",
        )


def _videos(page: Page, runs: Sequence[Run]) -> None:
    shown: list[tuple[Run, Path]] = []
    left_out: list[tuple[Run, Path]] = []
    size = 0
    for run in runs:
        for video in run.videos:
            size += video.stat().st_size
            (shown if size <= MAX_VIDEO_BYTES else left_out).append((run, video))
    if shown or left_out:
        page.section("Videos")
    for run, video in shown:
        page.video(video, f"{run.label}: {video.stem.replace('_', ' ')}")
    for run, video in left_out:
        page.text(f"Left out to keep the page small: `{video}` of {run.label}.")


def _configuration(page: Page, runs: Sequence[Run]) -> None:
    page.section("Configuration")
    if len(runs) > 1:
        page.text("What differs:")
        page.table(
            ["key", *(run.label for run in runs)], _differing([leaves(run.config) for run in runs])
        )
    for run in runs:
        page.details(
            f"Whole configuration of {run.label}", yaml.safe_dump(run.config, sort_keys=False)
        )


def _versions(page: Page, runs: Sequence[Run]) -> None:
    page.section("Versions")
    packages = list(dict.fromkeys(name for run in runs for name in run.versions))
    if packages:
        page.table(
            ["", *(run.label for run in runs)],
            [[p, *(r.versions.get(p, "") for r in runs)] for p in packages],
        )
    else:
        page.text("Not recorded by these runs.")


def _differing(columns: Sequence[dict[str, str]]) -> list[list[str]]:
    """Rows of the keys whose values are not the same everywhere."""
    keys = sorted(set().union(*columns))
    rows = [[key, *(_plain(column.get(key, "")) for column in columns)] for key in keys]
    return [row for row in rows if len(set(row[1:])) > 1]


def _plain(value: str) -> Any:
    """JSON text without the quotes of a string."""
    loaded = json.loads(value) if value else ""
    return loaded if isinstance(loaded, str) else value
