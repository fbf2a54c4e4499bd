"""``rrl reproduce``: run what is missing, then draw, judge and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from ..console import Output
from ..launch.job import Job
from ..launch.pool import Ending, launch, require_all
from ..storage.files import claimed
from ..training.interruption import Interruption
from .against_controller import HEADER, standing_row
from .claims import Verdict, judge
from .figures import draw
from .kept_runs import keep, kept_runs, take, train_again
from .numbers import write_numbers
from .outcomes import Finding, gather
from .plan import Compose, Point, plan_jobs, plan_points, plan_spreads
from .report import Shown, write_experiments, write_results
from .spec import Experiment, Settings, Spread, load_experiments, load_settings
from .video import rescue_video, task_videos


def reproduce(
    names: Sequence[str],
    changes: dict[str, Any],
    compose: Compose,
    folders: Sequence[Path],
    console: Output,
    again: str = "rrl reproduce",
) -> Path:
    """Make experiments again; a second call does what is missing.

    Args:
        names: Names of the experiments; none: all.
        changes: Changes of the settings in :file:`configs/reproduce.yaml`.
        compose: From overrides of ``rrl train`` to the resolved configuration.
        folders: Folders of configurations, the user's before ours.
        console: Where to show the progress.
        again: The command that goes on after an interruption.

    Returns:
        The report.

    Raises:
        BlockingIOError: If another process runs experiments in the same store.
        ValueError: If names or settings are unknown.
        Interrupted: By a signal; the runs have saved themselves.
        RuntimeError: If runs failed; everything else is done and reported.
    """
    settings = load_settings(folders, changes)
    experiments = load_experiments(names, folders)
    out = Path(settings.out).expanduser().resolve()
    planning = Interruption("stopping after the plan")
    with planning.listening():  # in the middle of Hydra's work it would end as an error of Hydra's
        points = plan_points(experiments, settings, compose)
    planning.check()
    console.say(f"the store is {out}")
    jobs = plan_jobs(points, out)
    # Of two commands each would take the other's runs for its own.
    with claimed(out) if settings.workers != 0 else nullcontext():
        ending = _run(jobs, plan_spreads(points, out), settings, console, again)
    name = "-".join(("report", *names))
    report = out / f"{name}.html"
    _show(experiments, points, settings, ending, report, console)
    require_all(ending, console)
    return report


def _run(
    jobs: Sequence[Job],
    spreads: Mapping[Path, Sequence[Spread]],
    settings: Settings,
    console: Output,
    again: str,
) -> Ending:
    """Take the runs that are kept, run the others and keep them too."""
    arguments = jobs, settings.launcher, settings.workers, console, again
    if settings.workers != 0:
        train_again(jobs)
    if settings.data is None:
        return launch(*arguments)
    data = Path(settings.data).expanduser().resolve()
    if data.exists() and not data.is_dir():
        raise ValueError(f"data: expected a folder, got the file {data}")
    data.mkdir(parents=True, exist_ok=True)
    taken = take(jobs, data, spreads)
    console.say(f"{len(taken)} runs are taken from {data}, without what they learned")
    if not any(job.finished for job in jobs) and (others := kept_runs(data)):
        console.say(
            f"none of the {others} runs kept there is one of these: they are of other experiments, "
            f"of another scale than {settings.scale}, or of other settings",
            style="yellow",
        )

    def kept(job: Job) -> None:
        try:
            keep(job, data, spreads[job.path])
        except (OSError, ValueError, KeyError) as error:  # the others go on; the store has the run
            console.say(f"{job.name} is not kept in {data}: {error!r}", style="yellow")

    return launch(*arguments, kept)


def _show(
    experiments: Sequence[Experiment],
    points: Sequence[Point],
    settings: Settings,
    ending: Ending,
    report: Path,
    console: Output,
) -> None:
    """Draw and report what is finished."""
    findings = gather(points, ending.done, report.parent)
    known = [experiment for experiment in experiments if experiment.name in findings]
    figures = {e.name: draw(e, findings[e.name], report.parent / "figures") for e in known}
    numbers = [
        write_numbers(e, findings[e.name], figures[e.name].with_suffix(".csv")) for e in known
    ]
    verdicts = judge({e.name: findings[e.name] for e in known if e.paper})
    tasks = [experiment for experiment in known if experiment.figure == "tasks"]
    clips = {e.name: task_videos(findings[e.name], console) for e in tasks}
    video = rescue_video(findings, console) if len(tasks) < len(known) else None
    if verdicts:
        console.print(_verdict_table(verdicts))
    for experiment in tasks:
        console.print(_task_table(experiment, findings[experiment.name]))
    shown = Shown(experiments, findings, figures, verdicts, settings, ending)
    pages = [write_experiments(shown, video, clips, report)]
    if known:
        name = report.stem.replace("report", "results", 1)
        pages.insert(0, write_results(shown, report.with_name(f"{name}.md")))
    for path in (*figures.values(), *numbers, *pages):
        console.say(f"  {path}")


def _task_table(experiment: Experiment, finding: Finding) -> Table:
    table = Table(*HEADER, title=experiment.title, title_justify="left", show_lines=True)
    for outcome in finding.outcomes:
        table.add_row(*standing_row(outcome))
    return table


def _verdict_table(verdicts: Sequence[Verdict]) -> Table:
    columns, title = ("claim", "verdict", "numbers"), "The paper's claims"
    table = Table(*columns, title=title, title_justify="left", show_lines=True)
    for verdict in verdicts:
        style = {True: "green", False: "red", None: "dim"}[verdict.holds]
        table.add_row(str(verdict.claim), Text(verdict.word, style=style), verdict.numbers)
    return table
