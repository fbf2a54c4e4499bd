"""What is shown of claims and experiments, on an HTML page or on a Markdown page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..report.markdown import MarkdownPage
from ..report.page import Page
from .claims import Verdict
from .front import front_rows
from .outcomes import Finding
from .spec import Experiment
from .standing import HEADER, READING, standing_row
from .tables import effort, final_rows, followed_rows, outcome_rows, overall_iqm, steps_rows

__all__ = ["STATISTICS", "add_claims", "add_experiment"]

STATISTICS = (
    "Every number is from frozen episodes without exploration, the same for every seed and arm; "
    "the controller alone runs the same episodes. Means are over seeds with Student's t interval; "
    "intervals of success count seeds, not episodes, as independent; IQM is the interquartile mean "
    "with a stratified bootstrap, which of at most three seeds is their mean."
)
CLAIMS_HEADER = ["claim", "the paper", "verdict", "numbers", "criterion"]


def add_claims(page: Page | MarkdownPage, verdicts: Sequence[Verdict]) -> None:
    """Add the paper's claims, its numbers beside ours."""
    rows = [[str(v.claim), v.claim.paper, v.word, v.numbers, v.claim.criterion] for v in verdicts]
    page.section("The paper's claims")
    page.table(CLAIMS_HEADER, rows)


def add_experiment(
    page: Page | MarkdownPage, experiment: Experiment, finding: Finding, figure: Path, how: str
) -> None:
    """Add an experiment's figure and tables, what they cost and the command that makes them."""
    if experiment.figure == "tasks":
        page.table(HEADER, [standing_row(outcome) for outcome in finding.outcomes])
        page.text(READING)
    page.image(figure, f"Experiment `{experiment.name}`")
    if experiment.figure == "front":
        page.table(*front_rows(experiment, finding))
    elif experiment.figure not in ("spread", "tasks"):
        _tables(page, experiment, finding)
    page.text(f"{effort(finding)} Again: `rrl reproduce {experiment.name} {how}`.")


def _tables(page: Page | MarkdownPage, experiment: Experiment, finding: Finding) -> None:
    first = finding.outcomes[0]
    page.table(*final_rows(experiment, finding))
    if experiment.figure == "curves" and first.follows("success"):
        page.table(*steps_rows(experiment, finding))
    if experiment.evaluated_at:
        page.table(*followed_rows(experiment, finding))
    in_detail = experiment.figure in ("table", "sweep") or len(first.scenarios) > 1
    if first.knows("success") and in_detail:
        page.table(*outcome_rows(experiment, finding))
    for arm in finding.arms if experiment.sweep else ():
        outcomes = finding.arm(arm)
        known = [entry for entry in ("return", "success") if outcomes[0].knows(entry)]
        text = "; ".join(f"{entry} {overall_iqm(outcomes, entry)}" for entry in known)
        page.text(f"{arm}, all settings, IQM with bootstrap stratified by setting: {text}.")
