"""The report: one HTML file with claims, figures, tables, a video, configurations and versions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from ..launch.pool import Ending
from ..report.page import Page
from ..storage.versions import versions
from .claims import Verdict, criterion
from .front import front_rows
from .outcomes import Finding, Findings
from .plan import command
from .spec import Experiment, Settings
from .standing import HEADER, notes, standing_row
from .tables import final_rows, followed_rows, overall_iqm, steps_rows, success_rows

__all__ = ["write_report"]


def write_report(
    experiments: Sequence[Experiment],
    findings: Findings,
    figures: Mapping[str, Path],
    verdicts: Sequence[Verdict],
    video: Path | None,
    clips: Mapping[str, Sequence[tuple[Path, str]]],
    settings: Settings,
    ending: Ending,
    out: Path,
) -> Path:
    """Write the HTML file ``out``; the figures enter as SVG.

    Args:
        experiments: What is shown, in this order.
        findings: Their numbers.
        figures: Their PNG files, each with an SVG beside it.
        verdicts: On the paper's claims.
        video: Of one rescued episode.
        clips: By experiment, videos of its tasks and what they show.
        settings: Of the command.
        ending: What became of the runs.
        out: The file.
    """
    page = Page("Residual reinforcement learning for robot control: the experiments again")
    page.text(
        f"Scale `{settings.scale}`: {_seeds(experiments, settings)} seeds, each a run of "
        "its own. Every number is from frozen episodes without exploration, the same for every "
        "seed and arm; the controller alone runs the same episodes. Means are over seeds with "
        "Student's t interval; intervals of success count seeds, not episodes, as independent; IQM "
        "is the interquartile mean with a stratified bootstrap."
    )
    if verdicts:
        page.section("The paper's claims")
        rows = [[v.claim, v.word, v.numbers, criterion(v.claim)] for v in verdicts]
        page.table(["claim", "verdict", "numbers", "criterion"], rows)
    if video is not None:
        page.section("One episode, twice")
        text = "The same frozen episode: the controller fails, with the residual it succeeds."
        page.video(video, text)
    for experiment in experiments:
        _experiment(page, experiment, findings[experiment.name], figures[experiment.name])
        _clips(page, experiment, clips.get(experiment.name, ()))
    _failures(page, ending)
    _configurations(page, experiments, findings, out.parent)
    page.section("Versions")
    page.table(["package", "version"], [[name, version] for name, version in versions().items()])
    return page.write(out)


def _experiment(page: Page, experiment: Experiment, finding: Finding, figure: Path) -> None:
    page.section(experiment.heading)
    if experiment.figure == "tasks":
        _standings(page, finding)
    page.image(figure.with_suffix(".svg"), f"Experiment `{experiment.name}`")
    if experiment.figure == "front":
        page.table(*front_rows(experiment, finding))
    if experiment.figure not in ("spread", "front", "tasks"):
        page.table(*final_rows(experiment, finding))
    if experiment.figure == "curves" and finding.outcomes[0].follows("success"):
        page.table(*steps_rows(finding))
    if experiment.evaluated_at:
        page.table(*followed_rows(experiment, finding))
    if finding.outcomes[0].knows("success") and (
        experiment.figure in ("table", "sweep") or len(finding.outcomes[0].scenarios) > 1
    ):
        page.table(*success_rows(experiment, finding))
    for arm in finding.arms if experiment.sweep else ():
        outcomes = finding.arm(arm)
        known = [entry for entry in ("return", "success") if outcomes[0].knows(entry)]
        text = "; ".join(f"{entry} {overall_iqm(outcomes, entry)}" for entry in known)
        page.text(f"{arm}, all settings, IQM with bootstrap stratified by setting: {text}.")
    page.text(f"Again: `rrl reproduce {experiment.name}`.")


def _standings(page: Page, finding: Finding) -> None:
    page.table(HEADER, [standing_row(outcome) for outcome in finding.outcomes])
    for text in notes(finding):
        page.text(text)


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


def _seeds(experiments: Sequence[Experiment], settings: Settings) -> str:
    usual = settings.scales[settings.scale].seeds
    return " or ".join(map(str, sorted({e.seeds or usual for e in experiments})))


def _failures(page: Page, ending: Ending) -> None:
    if ending.failed or ending.blocked:
        page.section("Runs that failed")
    for job in ending.failed:
        page.details(job.name, job.log_tail(60))
    for job in ending.blocked:
        page.text(f"`{job.name}` was not started: it needs {', '.join(map(str, job.needs))}.")


def _configurations(
    page: Page, experiments: Sequence[Experiment], findings: Findings, out: Path
) -> None:
    page.section("Configurations")
    page.text("Each run can be made again alone, with the command that stands first.")
    outcomes = [outcome for e in experiments for outcome in findings[e.name].outcomes]
    for outcome in {outcome.point.key: outcome for outcome in outcomes}.values():
        run = outcome.runs[0]
        again = command(outcome.point, run.config["trainer"]["seed"], out)
        config = yaml.safe_dump(run.config, sort_keys=False)
        title = f"{run.path.parent.name}, {len(outcome.runs)} seeds"
        page.details(title, f"{again}\n\n{config}")
