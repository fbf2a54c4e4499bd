"""``rrl reproduce``: run what is missing, then draw, judge and report."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ..launch import launchers
from ..launch.display import Display
from ..launch.pool import Ending, run_jobs, tail
from ..launch.store import Store
from ..training.interruption import Interrupted, Interruption
from .claims import Verdict, judge
from .figures import draw
from .outcomes import Findings, gather
from .plan import Compose, Job, Point, plan_jobs, plan_points
from .report import write_report
from .spec import Experiment, Settings, load_experiments, load_settings
from .video import rescue_video


def reproduce(
    names: Sequence[str],
    changes: dict[str, Any],
    compose: Compose,
    folders: Sequence[Path],
    console: Console,
) -> Path:
    """Make experiments again; a second call does what is missing.

    Args:
        names: of the experiments; none: all.
        changes: of the settings in :file:`configs/reproduce.yaml`.
        compose: from overrides of ``rrl train`` to the resolved configuration.
        folders: folders of configurations, the user's before ours.
        console: where to show how far it is.

    Returns:
        The report.

    Raises:
        ValueError: unknown names or settings.
        Interrupted: by SIGTERM or Ctrl-C; the runs have saved themselves.
        RuntimeError: if runs failed; everything else is done and reported.
    """
    settings = load_settings(folders, changes)
    experiments = load_experiments(names, folders)
    store = Store(Path(settings.out))
    planning = Interruption("stopping after the plan")
    with (
        planning.listening()
    ):  # a signal in the middle of Hydra's work would end as an error of Hydra's
        points = plan_points(experiments, settings, compose)
    planning.check()
    launcher = launchers.make(settings.launcher, settings.workers)
    try:
        jobs = plan_jobs(points, store, settings.scales[settings.scale].stack, launcher.slots)
        _announce(jobs, store, launcher.slots, console)
        ending = run_jobs(jobs, store, launcher, Display(console))
    except Interrupted:
        command = shlex.join(
            ["rrl", "reproduce", *names, *(f"{key}={value}" for key, value in changes.items())]
        )
        console.print(
            f"stopped; what was done is in {store.out}; to go on:\n  {command}", soft_wrap=True
        )
        raise
    finally:
        launcher.close()
    path = store.out / ("report.html" if not names else f"report-{'-'.join(names)}.html")
    report = _show(experiments, points, store, settings, ending, path, console)
    _complain(ending, console)
    return report


def _announce(jobs: Sequence[Job], store: Store, slots: int, console: Console) -> None:
    left = [job for job in jobs if not job.run.finished]
    steps = sum(job.work for job in left)
    console.print(
        f"{len(jobs)} runs, {len(jobs) - len(left)} of them finished; {steps:,} environment steps to go, "
        f"{slots} runs at a time, in {store.out}",
        highlight=False,
        soft_wrap=True,
    )


def _show(
    experiments: Sequence[Experiment],
    points: Sequence[Point],
    store: Store,
    settings: Settings,
    ending: Ending,
    out: Path,
    console: Console,
) -> Path:
    """Draw and report what is finished."""
    findings: Findings = {
        name: finding for name, finding in gather(points, store).items() if finding.outcomes
    }
    shown = [experiment for experiment in experiments if experiment.name in findings]
    figures = {e.name: draw(e, findings[e.name], store.out / "figures") for e in shown}
    verdicts = judge(findings)
    video = rescue_video(findings, console)
    if verdicts:
        console.print(_verdict_table(verdicts))
    report = write_report(shown, findings, figures, verdicts, video, settings, ending, out)
    for path in (*figures.values(), report):
        console.print(f"  {os.path.relpath(path)}", highlight=False, soft_wrap=True)
    return report


def _verdict_table(verdicts: Sequence[Verdict]) -> Table:
    table = Table(title="The paper's claims", title_justify="left", show_lines=True)
    for column in ("claim", "verdict", "numbers"):
        table.add_column(column)
    for verdict in verdicts:
        style = {True: "green", False: "red", None: "dim"}[verdict.holds]
        table.add_row(
            verdict.claim, f"[{style}]{verdict.word}[/]", verdict.numbers.replace("[", "\\[")
        )
    return table


def _complain(ending: Ending, console: Console) -> None:
    """Name the runs that failed, each with the end of its log."""
    for job in ending.failed:
        console.print(
            f"\nFAILED {job.run.name}: {job.run.log}", style="red", highlight=False, soft_wrap=True
        )
        console.print(tail(job.run), highlight=False, markup=False, soft_wrap=True)
    for job in ending.blocked:
        needs = ", ".join(run.name for run in job.needs)
        console.print(
            f"\nNOT STARTED {job.run.name}: it needs {needs}",
            style="red",
            highlight=False,
            soft_wrap=True,
        )
    if ending.failed or ending.blocked:
        count = len(ending.failed) + len(ending.blocked)
        raise RuntimeError(
            f"{count} runs are missing, {len(ending.failed)} failed; the same command tries them again"
        )
