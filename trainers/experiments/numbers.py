"""The numbers behind an experiment's figure as one CSV file: a row for every run and evaluation."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rrl.keys import METRICS

from ..metric_names import ACCEPTED, CONTROLLER, P99
from ..report.runs import Run
from .outcomes import Finding, Outcome
from .spec import Experiment
from .spread import spatial_variance

POLICIES = {"controller": CONTROLLER, "latest": "", "handed_over": ACCEPTED}
"""Column's beginning to that of an entry."""
ENTRIES = {
    f"{policy}_{entry}": prefix + entry
    for entry in ("success", "return")
    for policy, prefix in POLICIES.items()
}
"""Every column of a policy, and the entry that it holds."""
CHANGES = ("rescues", "regressions", f"{ACCEPTED}rescues", f"{ACCEPTED}regressions")
COLUMNS = (
    *("arm", "setting", "key", "seed", "env_steps", "evaluation", "scenario", "episodes"),
    *ENTRIES,
    *CHANGES,
    *("wall_time_s", "versions"),
)
"""Then the metric's mean and 99th percentile by policy, where success is drawn against one, or the
variance by axis, where it is shown.

``evaluation`` is ``training`` or ``final``; what was not measured is empty, and what needs a
controller is for an arm that acts without one. Success is a share,
``rescues`` and ``regressions`` are numbers of episodes, of the latest policy and of what is handed
over; wall time and versions are those of the whole run."""

Row = Mapping[str, Any]


def write_numbers(experiment: Experiment, finding: Finding, path: Path) -> Path:
    """Write the file ``path`` with :data:`COLUMNS` and return it."""
    with path.open("w", newline="", encoding="utf-8") as file:
        spread = experiment.spread.columns if experiment.spread else []
        columns = [*COLUMNS, *_metric(experiment), *spread]
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        for outcome in finding.outcomes:
            point = outcome.point
            setting = "" if point.value is None else point.value
            for run in outcome.runs:
                of_run = {"arm": point.arm, "setting": setting, "key": point.key, "seed": run.seed}
                for row in (*_training(run), *_final(experiment, outcome, run)):
                    writer.writerow({**of_run, **(_alone(row) if outcome.acts_alone else row)})
    return path


def _alone(row: Row) -> Row:
    """The row without what compares with a controller: with none it would be with doing nothing."""
    return {
        column: value
        for column, value in row.items()
        if column not in CHANGES and not column.startswith(CONTROLLER)
    }


def _training(run: Run) -> Iterator[Row]:
    """The evaluations while the run learned."""
    columns = {column: dict(run.evaluations(entry)) for column, entry in ENTRIES.items()}
    episodes = run.config["trainer"]["evaluation"]["episodes"]
    common = {"evaluation": "training", "scenario": run.followed, "episodes": episodes}
    for step in sorted({step for values in columns.values() for step in values}):
        found = {column: values[step] for column, values in columns.items() if step in values}
        yield {"env_steps": step, **common, **found}


def _final(experiment: Experiment, outcome: Outcome, run: Run) -> Iterator[Row]:
    """The final evaluation, scenario by scenario."""
    more: dict[str, Any] = {"wall_time_s": round(run.seconds, 1)}
    more["versions"] = " ".join(f"{name}={version}" for name, version in run.versions.items())
    if spread := experiment.spread:
        more |= zip(spread.columns, spatial_variance(run, spread).tolist(), strict=True)
    total = run.config["trainer"]["total_steps"]
    common = {"env_steps": total, "evaluation": "final", "episodes": outcome.episodes}
    for scenario in outcome.scenarios:
        summary = run.summary(scenario)
        entries = ENTRIES | _metric(experiment)
        found = {column: summary[entry] for column, entry in entries.items() if entry in summary}
        found |= {entry: summary[entry] for entry in CHANGES if entry in summary}
        yield {**common, "scenario": scenario, **found, **more}


def _metric(experiment: Experiment) -> dict[str, str]:
    """The columns of what success is drawn against, and their entries."""
    names = [f"{experiment.metric}{end}" for end in ("", P99)] if experiment.metric else []
    return {
        f"{policy}_{name}": f"{prefix}{METRICS}/{name}"
        for name in names
        for policy, prefix in POLICIES.items()
    }
