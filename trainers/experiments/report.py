"""The report: one HTML file with everything, and a Markdown page for a repository's documents."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from ..launch.job import Job
from ..launch.pool import Ending
from ..report.markdown import MarkdownPage
from ..report.page import Page
from . import changes
from .against_controller import HEADER, READING, standing_row
from .claims import Verdict
from .front import front_rows
from .outcomes import Finding, Findings
from .plan import command
from .spec import Experiment, Settings
from .tables import effort, final_rows, followed_rows, outcome_rows, overall_iqm, steps_rows

TITLE = "Residual reinforcement learning for robot control: the experiments again"
STATISTICS = (
    "Every number is from frozen episodes without exploration, the same for every seed and arm; "
    "the controller alone runs the same episodes. Means are over seeds with Student's t interval; "
    "intervals of final success are over runs and the episodes that all of them play, bands of "
    "curves over runs on these episodes; IQM is the interquartile mean with a stratified "
    "bootstrap, which of at most three seeds is their mean. Numbers that are all alike, and those "
    "of a single seed, have no interval, unless they are of final success."
)
CLAIMS_HEADER = ["claim", "the paper", "verdict", "numbers", "criterion"]


@dataclass(frozen=True)
class Shown:
    """What both pages show.

    Attributes:
        experiments: In this order.
        findings: Their numbers.
        figures: Their PNG files, each with an SVG beside it.
        verdicts: On the paper's claims.
        settings: Of the command.
        ending: What became of the runs.
    """

    experiments: Sequence[Experiment]
    findings: Findings
    figures: Mapping[str, Path]
    verdicts: Sequence[Verdict]
    settings: Settings
    ending: Ending

    @property
    def introduction(self) -> str:
        """Scale, seeds and statistics."""
        counts = {self.settings.seeds_of(experiment) for experiment in self.experiments}
        seeds = " or ".join(map(str, sorted(counts)))
        return f"Scale `{self.settings.scale}`, seeds: {seeds}, each a run of its own. {STATISTICS}"


def write_experiments(
    shown: Shown, video: Path | None, clips: Mapping[str, Sequence[tuple[Path, str]]], out: Path
) -> Path:
    """Write the HTML file ``out``: also videos, failures, configurations; figures enter as SVG.

    Args:
        shown: What is shown.
        video: Of one rescued episode.
        clips: By experiment, videos of its tasks and what they show.
        out: The file.
    """
    page = Page(TITLE)
    page.text(shown.introduction)
    _add_claims(page, shown.verdicts)
    if video is not None:
        page.section("One episode, twice")
        text = "The same frozen episode: the controller fails, with the residual it succeeds."
        page.video(video, text)
    for experiment in shown.experiments:
        page.section(experiment.heading)
        _add(page, shown, experiment)
        _clips(page, experiment, clips.get(experiment.name, ()))
    _failures(page, shown.ending)
    for job in shown.ending.failed:
        page.details(job.name, job.log_tail(60))
    _configurations(page, shown, out.parent)
    page.section("Versions")
    page.text(_versions_of_runs(shown))
    return page.write(out)


def write_results(shown: Shown, out: Path) -> Path:
    """Write the Markdown file ``out``, whose figures stay in a folder beside it."""
    alone = len(shown.experiments) == 1
    page = MarkdownPage(shown.experiments[0].heading if alone else TITLE)
    page.text(
        "`rrl reproduce` wrote this page, a report with videos and configurations, and the numbers "
        f"behind each figure as CSV. {shown.introduction}"
    )
    _add_claims(page, shown.verdicts)
    for experiment in shown.experiments:
        if not alone:
            page.section(experiment.heading)
        _add(page, shown, experiment, out.parent)
    _failures(page, shown.ending)
    page.section("Versions")
    page.text(_versions_of_runs(shown))
    return page.write(out)


def _add_claims(page: Page | MarkdownPage, verdicts: Sequence[Verdict]) -> None:
    """Add the paper's claims, its numbers beside ours."""
    if verdicts:
        page.section("The paper's claims")
        rows = [
            [str(v.claim), v.claim.paper, v.word, v.numbers, v.claim.criterion] for v in verdicts
        ]
        page.table(CLAIMS_HEADER, rows)


def _add(
    page: Page | MarkdownPage, shown: Shown, experiment: Experiment, beside: Path | None = None
) -> None:
    """Add an experiment's figure and tables, what they cost and the command that makes them.

    The figure is added as SVG, or as PNG by the way to it from the page's folder ``beside``.
    """
    if (finding := shown.findings.get(experiment.name)) is None:
        page.text("No run is finished yet.")
        return
    if experiment.figure == "tasks":
        page.table(HEADER, [standing_row(outcome) for outcome in finding.outcomes])
        page.text(READING)
    if experiment.figure == "changes":
        for measure in changes.MEASURES:
            page.text(f"Success, or return where none is reported; {measure.name}:")
            page.table(*changes.change_rows(experiment, finding, measure))
        page.text(changes.READING)
    png = shown.figures[experiment.name]
    figure = png.relative_to(beside) if beside else png.with_suffix(".svg")
    page.image(figure, f"Experiment `{experiment.name}`")
    if experiment.figure == "front":
        page.table(*front_rows(experiment, finding))
    elif experiment.figure not in ("spread", "tasks", "changes"):
        _tables(page, experiment, finding)
    again = ["rrl", "reproduce", experiment.name, f"scale={shown.settings.scale}"]
    again += [] if shown.settings.seeds is None else [f"seeds={shown.settings.seeds}"]
    page.text(f"{effort(finding)} Again: `{shlex.join(again)}`.")


def _tables(page: Page | MarkdownPage, experiment: Experiment, finding: Finding) -> None:
    shown = [final_rows(experiment, finding)]
    if experiment.figure == "curves":
        shown.append(steps_rows(experiment, finding))
    if experiment.evaluated_at:
        shown.append(followed_rows(experiment, finding))
    if experiment.figure in ("table", "sweep") or len(finding.scenarios) > 1:
        shown.append(outcome_rows(experiment, finding))
    for header, rows in shown:
        if rows:  # none where no arm reports success
            page.table(header, rows)
    for arm in finding.arms if experiment.sweep else ():
        text = "all settings, IQM of the return with bootstrap stratified by setting"
        page.text(f"{arm}, {text}: {overall_iqm(finding.arm(arm))}.")


def _versions_of_runs(shown: Shown) -> str:
    found: dict[str, set[str]] = {}
    for finding in shown.findings.values():
        for run in (run for outcome in finding.outcomes for run in outcome.runs):
            for name, version in run.versions.items():
                found.setdefault(name, set()).add(version)
    text = ", ".join(f"{name} {' or '.join(sorted(each))}" for name, each in found.items())
    return text + "." if text else "Known when a run is finished."


def _clips(page: Page, experiment: Experiment, clips: Sequence[tuple[Path, str]]) -> None:
    if not clips:
        return
    page.section(f"{experiment.title}: videos")
    page.text(
        "Left the controller alone, right what the run hands over, on the same episode: the first "
        "that the controller fails and the policy solves, or else the first. Where a run hands "
        "over the controller, both halves show it."
    )
    page.videos(clips)


def _failures(page: Page | MarkdownPage, ending: Ending) -> None:
    if ending.failed or ending.blocked:
        page.section("Runs that failed")
    if ending.failed:
        page.text(f"Failed: {_names(ending.failed)}.")
    if ending.blocked:
        page.text(f"Not started, as they need one that failed: {_names(ending.blocked)}.")


def _names(jobs: Sequence[Job]) -> str:
    return ", ".join(f"`{job.name}`" for job in jobs)


def _configurations(page: Page, shown: Shown, out: Path) -> None:
    page.section("Configurations")
    page.text("Each run can be made again alone, with the command that stands first.")
    outcomes = [o for finding in shown.findings.values() for o in finding.outcomes]
    for outcome in {outcome.point.key: outcome for outcome in outcomes}.values():
        run = outcome.runs[0]
        again = command(outcome.point, run.config["trainer"]["seed"], out)
        config = yaml.safe_dump(run.config, sort_keys=False)
        title = f"{run.path.parent.name}, {len(outcome.runs)} seeds"
        page.details(title, f"{again}\n\n{config}")
