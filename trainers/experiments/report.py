"""The report: one HTML file with claims, figures, tables, a video, configurations and versions."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml

from ..launch.pool import Ending, tail
from ..launch.store import recorded_overrides
from ..report.page import Page
from ..storage.versions import versions
from .claims import Verdict, criterion
from .outcomes import Finding, Findings
from .spec import Experiment, Settings
from .tables import final_rows, overall_iqm, success_rows


def write_report(
    experiments: Sequence[Experiment],
    findings: Findings,
    figures: Mapping[str, Path],
    verdicts: Sequence[Verdict],
    video: Path | None,
    settings: Settings,
    ending: Ending,
    out: Path,
) -> Path:
    """Write the HTML file ``out``; the figures enter as SVG."""
    page = Page("Residual reinforcement learning for robot control: the experiments again")
    scale = settings.scales[settings.scale]
    page.text(
        f"Scale `{settings.scale}`: {scale.seeds} seeds. Every number is from frozen episodes without exploration, "
        "the same for every seed and arm; the controller alone runs the same episodes. Means are over seeds with "
        "Student's t interval; IQM is the interquartile mean with a stratified bootstrap."
    )
    _claims(page, verdicts)
    if video is not None:
        page.section("One episode, twice")
        page.video(
            video,
            "The same frozen episode: the controller alone fails, with the learned residual it succeeds.",
        )
    for experiment in experiments:
        _experiment(page, experiment, findings[experiment.name], figures[experiment.name])
    _failures(page, ending)
    _configurations(page, experiments, findings)
    page.section("Versions")
    page.table(["package", "version"], [[name, version] for name, version in versions().items()])
    return page.write(out)


def _claims(page: Page, verdicts: Sequence[Verdict]) -> None:
    page.section("The paper's claims")
    page.table(
        ["claim", "verdict", "numbers", "criterion"],
        [[v.claim, v.word, v.numbers, criterion(v.claim)] for v in verdicts],
    )


def _experiment(page: Page, experiment: Experiment, finding: Finding, figure: Path) -> None:
    page.section(f"{experiment.title} ({experiment.paper})")
    page.image(figure.with_suffix(".svg"), f"Experiment `{experiment.name}`")
    if experiment.figure != "spread":
        page.table(*final_rows(experiment, finding))
    if finding.outcomes[0].knows("success") and experiment.figure in ("table", "sweep"):
        page.table(*success_rows(experiment, finding))
    if experiment.sweep:
        for arm in finding.arms:
            outcomes = finding.arm(arm)
            said = "; ".join(
                f"{e} {overall_iqm(outcomes, e)}"
                for e in ("return", "success")
                if outcomes[0].knows(e)
            )
            page.text(
                f"{arm}, all settings together, IQM with bootstrap stratified by setting: {said}."
            )
    page.text(f"Again: `rrl reproduce {experiment.name}`.")


def _failures(page: Page, ending: Ending) -> None:
    if not ending.failed and not ending.blocked:
        return
    page.section("Runs that failed")
    for job in ending.failed:
        page.details(job.run.name, tail(job.run, 60))
    for job in ending.blocked:
        page.text(
            f"`{job.run.name}` was not started: it needs {', '.join(run.name for run in job.needs)}."
        )


def _configurations(page: Page, experiments: Sequence[Experiment], findings: Findings) -> None:
    page.section("Configurations")
    page.text(
        "Each run can be made again alone, with the command that its configuration begins with."
    )
    shown = set()
    for experiment in experiments:
        for outcome in findings[experiment.name].outcomes:
            for run in outcome.runs:
                if run.path in shown:
                    continue
                shown.add(run.path)
                command = shlex.join(["rrl", "train", *recorded_overrides(run.path)])
                page.details(
                    run.label, f"{command}\n\n{yaml.safe_dump(run.config, sort_keys=False)}"
                )
