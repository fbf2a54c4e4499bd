"""The experiments' numbers as rows of text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..evaluation.statistics import iqm, iqm_interval, mean_interval, success_interval
from ..metric_names import CONTROLLER
from ..report.tables import number, with_interval
from .figure_style import unit_of
from .outcomes import SOLVED, Counts, Finding, Outcome
from .spec import Experiment

Table = tuple[list[str], list[list[str]]]
"""Header and rows."""

TRIALS = 20
"""Of the paper's table; rates are also given as so many of twenty."""


def outcome_rows(experiment: Experiment, finding: Finding) -> Table:
    """Return successes by scenario, every arm and the controller on the same episodes."""
    header = ["scenario", *_arm_header(experiment)]
    header += ["succeeded, by seed [95 % interval of the rate]", "of 20", "controller", "of 20"]
    header += ["rescued / broken", "McNemar's p, by seed"]
    return header, [
        _success_row(outcome, scenario)
        for outcome in finding.outcomes
        if outcome.knows("success")
        for scenario in outcome.scenarios
    ]


def final_rows(experiment: Experiment, finding: Finding) -> Table:
    """Return final return and success of every arm at every setting, over seeds."""
    known = [e for e in ("return", "success") if any(o.knows(e) for o in finding.outcomes)]
    header = [*_arm_header(experiment), "seeds"]
    for entry in known:
        header += [f"{entry}: mean [95 % CI]", f"controller's {entry}"]
    rows = [[*_final_row(o, known), overall_iqm([o])] for o in finding.outcomes]
    return [*header, "return: IQM [bootstrap 95 %]"], rows


def followed_rows(experiment: Experiment, finding: Finding) -> Table:
    """Return the successes of every arm at the steps that the experiment names, over seeds."""
    at = [f"success after {steps} steps" for steps in experiment.evaluated_at]
    return [*_arm_header(experiment), *at], [
        [*_arm(outcome), *_followed(outcome, experiment.evaluated_at)]
        for outcome in finding.outcomes
        if outcome.follows("success")
    ]


def _followed(outcome: Outcome, steps: Sequence[int]) -> list[str]:
    found = outcome.curve("success")
    band = found.band(outcome.followed_episodes)
    assert band is not None
    columns = np.array([found.mean, *band])[:, np.searchsorted(found.steps, steps)]
    return [with_interval(mean, (low, high), 100.0) for mean, low, high in columns.T]


def steps_rows(experiment: Experiment, finding: Finding) -> Table:
    """Return how many environment steps the runs of every arm needed."""
    header = [*_arm_header(experiment), f"environment steps to {SOLVED:.0%}, by seed"]
    header += ["median", "reached by"]
    rows = []
    for outcome in (o for o in finding.outcomes if o.follows("success")):
        steps = outcome.steps_to(SOLVED)
        each = ", ".join("never" if s is None else f"{s:.0f}" for s in steps)
        median = float(np.median([np.inf if s is None else s for s in steps]))
        middle = f"{median:.0f}" if np.isfinite(median) else "not reached"
        reached = f"{sum(s is not None for s in steps)} of {len(steps)}"
        rows.append([*_arm(outcome), each, middle, reached])
    return header, rows


def effort(finding: Finding) -> str:
    """Return how many runs each arm has, and what they took."""
    times = [run.seconds for outcome in finding.outcomes for run in outcome.runs]
    asked = f"Seeds of every arm: {len(finding.planned[0].seeds)}."
    whole = f"Finished so far: {finding.missing}." if finding.missing else asked
    return (
        f"{whole} Wall time of all {len(times)} runs together, one after the other: "
        f"{sum(times) / 3600:.1f} h; side by side it is divided by the number of workers, as long "
        "as each has a core."
    )


def overall_iqm(outcomes: Sequence[Outcome]) -> str:
    """Return the returns' interquartile mean over seeds and settings, resampled within settings.

    Not that of success: nearly all of its values may be alike, and they have an interval already.
    """
    strata = [outcome.final("return") for outcome in outcomes]
    return with_interval(iqm(*strata), iqm_interval(*strata))


def _success_row(outcome: Outcome, scenario: str) -> list[str]:
    cells = [scenario, *_arm(outcome), *_counted(outcome.counts(scenario))]
    if outcome.acts_alone:
        return [*cells, "none", "", "", ""]
    cells += _counted(outcome.counts(scenario, CONTROLLER))
    if not outcome.paired(scenario):
        return [*cells, "not paired", ", ".join(map(_unpaired_test, outcome.summaries(scenario)))]
    changes = [outcome.final(entry, scenario).sum() for entry in ("rescues", "regressions")]
    cells.append(f"{changes[0]:.0f} / {changes[1]:.0f}")
    return [*cells, ", ".join(f"{p:.1g}" for p in outcome.final("mcnemar_p", scenario))]


def _counted(counts: Counts) -> list[str]:
    return [str(counts), f"{TRIALS * counts.rate:.1f}"]


def _unpaired_test(summary: Mapping[str, float]) -> str:
    """Return the p-value of one run, of which others found the episodes not to be frozen."""
    if "mcnemar_p" in summary:
        return f"{summary['mcnemar_p']:.1g}"
    return f"{summary['fisher_p']:.1g} (Fisher's)"


def _final_row(outcome: Outcome, entries: Sequence[str]) -> list[str]:
    cells = [*_arm(outcome), str(len(outcome.runs))]
    for entry in entries:
        if not outcome.knows(entry):
            cells += ["", ""]
            continue
        values, controller = outcome.final(entry), outcome.final(f"controller_{entry}")
        unit = unit_of(entry)
        cells.append(with_interval(values.mean(), interval_of(outcome, entry), unit))
        cells.append("none" if outcome.acts_alone else number(controller.mean(), unit))
    return cells


def interval_of(outcome: Outcome, entry: str, scenario: str | None = None) -> tuple[float, float]:
    """Return the 95 % interval of a final entry's mean over seeds; of a rate within 0 and 1."""
    if entry == "success":
        return success_interval(outcome.counts(scenario).solved)
    return mean_interval(outcome.final(entry, scenario))


def _arm_header(experiment: Experiment) -> list[str]:
    """Return the columns of :func:`_arm`."""
    return ["arm", experiment.sweep.name] if experiment.sweep else ["arm"]


def _arm(outcome: Outcome) -> list[str]:
    """Return an arm's name, and its setting if there is a sweep."""
    point = outcome.point
    return [point.arm] if point.value is None else [point.arm, f"{point.value:g}"]
