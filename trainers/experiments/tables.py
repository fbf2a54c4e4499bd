"""The experiments' numbers as rows of text."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..evaluation.statistics import iqm, iqm_interval
from .outcomes import Finding, Outcome
from .spec import Experiment

Table = tuple[list[str], list[list[str]]]
"""Header and rows."""

TRIALS = 20
"""Of the paper's table; rates are also given as so many of twenty."""


def success_rows(experiment: Experiment, finding: Finding) -> Table:
    """Counts of success by scenario, controller against every arm on the same episodes."""
    setting = _setting(experiment)
    header = [
        "scenario",
        "arm",
        *setting,
        "succeeded (all seeds)",
        "95 % interval",
        "of 20",
        "controller",
        "of 20",
    ]
    header += ["rescued / broken", "McNemar's p, by seed"]
    return header, [
        _success_row(outcome, scenario, bool(setting))
        for outcome in finding.outcomes
        if outcome.knows("success")
        for scenario in outcome.scenarios
    ]


def final_rows(experiment: Experiment, finding: Finding) -> Table:
    """Final return and success of every arm at every setting, with mean and interquartile mean over seeds."""
    setting = _setting(experiment)
    header = [
        "arm",
        *setting,
        "seeds",
        "return: mean [95 % CI]",
        "return: IQM [bootstrap 95 %]",
        "controller's return",
    ]
    header += [
        "success [%]: mean [95 % CI]",
        "success [%]: IQM [bootstrap 95 %]",
        "controller's success [%]",
    ]
    return header, [_final_row(outcome, bool(setting)) for outcome in finding.outcomes]


def overall_iqm(outcomes: Sequence[Outcome], entry: str) -> str:
    """Interquartile mean over seeds and settings, resampled within each setting."""
    return _iqm(
        [outcome.final(entry) for outcome in outcomes], 100.0 if entry.endswith("success") else 1.0
    )


def _setting(experiment: Experiment) -> list[str]:
    """The column of the sweep's values, if there is a sweep."""
    return [experiment.sweep.key.rpartition(".")[2]] if experiment.sweep else []


def _success_row(outcome: Outcome, scenario: str, with_setting: bool) -> list[str]:
    count = outcome.episodes
    rates = outcome.final("success", scenario)
    solved, trials = round(float(rates.sum()) * count), count * len(rates)
    controller = round(float(outcome.final("controller_success", scenario)[0]) * count)
    rescued, broken = (
        int(outcome.final(entry, scenario).sum()) for entry in ("rescues", "regressions")
    )
    return [
        scenario,
        outcome.point.arm,
        *([f"{outcome.point.value:g}"] if with_setting else []),
        f"{solved} of {trials}",
        _percent(outcome.interval("success", scenario)),
        f"{TRIALS * solved / trials:.1f}",
        f"{controller} of {count} {_percent(outcome.interval('controller_success', scenario))}",
        f"{TRIALS * controller / count:.1f}",
        f"{rescued} / {broken}",
        ", ".join(f"{p:.1g}" for p in outcome.final("mcnemar_p", scenario)),
    ]


def _final_row(outcome: Outcome, with_setting: bool) -> list[str]:
    cells = [
        outcome.point.arm,
        *([f"{outcome.point.value:g}"] if with_setting else []),
        str(len(outcome.seeds)),
    ]
    for entry, unit in (("return", 1.0), ("success", 100.0)):
        if not outcome.knows(entry):
            return [*cells, "", "", ""]
        values = outcome.final(entry)
        mean = f"{values.mean() * unit:.2f} {_interval(outcome.interval(entry), unit)}"
        controller = (
            "none"
            if outcome.acts_alone
            else f"{outcome.final(f'controller_{entry}').mean() * unit:.2f}"
        )
        cells += [mean, _iqm([values], unit), controller]
    return cells


def _iqm(strata: Sequence[np.ndarray], unit: float) -> str:
    return f"{iqm(*strata) * unit:.2f} {_interval(iqm_interval(*strata), unit)}"


def _interval(interval: tuple[float, float], unit: float) -> str:
    low, high = (end * unit for end in interval)
    return "(one run)" if math.isnan(low) else f"[{low:.2f}, {high:.2f}]"


def _percent(interval: tuple[float, float]) -> str:
    return f"[{interval[0]:.1%}, {interval[1]:.1%}]"
