"""What the runs of a point came to, its seeds put together again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..evaluation.statistics import success_interval
from ..launch.job import Job
from ..loggers import metrics
from ..metric_names import CONTROLLER
from ..report.curves import Curve, Floats, curve
from ..report.runs import Run
from ..report.tables import brackets
from .plan import Point, run_directory
from .spread import spatial_variance

SOLVED = 0.9
"""Success of the followed episodes that counts as having learned the task."""
ROUNDING = 1e-9
"""By how much a mean of rates may be off, or its share by which one of returns may."""


@dataclass(frozen=True)
class Counts:
    """Successes of several runs.

    Attributes:
        solved: Whether each run solves each episode ``[S, N]``.
    """

    solved: NDArray[np.bool_]

    @property
    def rate(self) -> float:
        """Share of the episodes that are solved."""
        return float(self.solved.mean())

    def __str__(self) -> str:
        each = "/".join(map(str, self.solved.sum(axis=1)))
        interval = brackets(success_interval(self.solved), ".0f", 100.0, "%")
        return f"{each} of {self.solved.shape[1]} {interval}"


@dataclass(frozen=True)
class Outcome:
    """The finished runs of one point.

    Attributes:
        point: Arm, setting, configuration.
        runs: One for each seed that is finished.
    """

    point: Point
    runs: tuple[Run, ...]

    @property
    def followed(self) -> str:
        """The scenario that was evaluated during training."""
        return self.runs[0].followed

    @property
    def scenarios(self) -> list[str]:
        """Scenarios of the final evaluation."""
        return list(self.runs[0].results)

    @property
    def measured_by(self) -> str:
        """``success`` where the environment reports it, else ``return``."""
        return "success" if self.knows("success") else "return"

    @property
    def acts_alone(self) -> bool:
        """Whether the policy has no controller below it."""
        return str(self.point.config["controller"]["_target_"]).endswith(".ZeroController")

    @cached_property
    def episodes(self) -> int:
        """Frozen episodes of each scenario in the final evaluation."""
        return len(self.runs[0].results[self.followed]["episodes"]["return"])

    @property
    def followed_episodes(self) -> int:
        """Frozen episodes of an evaluation during training."""
        return int(self.point.config["trainer"]["evaluation"]["episodes"])

    def final(self, entry: str, scenario: str | None = None) -> Floats:
        """Return one entry of the final evaluation's summary, by seed ``[S]``."""
        return np.array([summary[entry] for summary in self.summaries(scenario)], dtype=float)

    def summaries(self, scenario: str | None = None) -> list[Mapping[str, float]]:
        """Return the final evaluation's summaries, by seed; None: in the followed scenario."""
        return [run.summary(scenario) for run in self.runs]

    def paired(self, scenario: str | None = None) -> bool:
        """Return whether all runs found the episodes to be frozen."""
        return self.knows("mcnemar_p", scenario)

    def counts(self, scenario: str | None = None, prefix: str = "") -> Counts:
        """Return which episodes each run solves, or with ``prefix`` what that prefix stands for.

        The controller alone, where the episodes are paired, solves the same in every run.
        """
        key = scenario or self.followed
        solved = [run.results[key]["episodes"][f"{prefix}success"] for run in self.runs]
        alike = prefix == CONTROLLER and self.paired(scenario)
        return Counts(np.array(solved[:1] if alike else solved, dtype=bool))

    def variances(self) -> Floats:
        """Return the variance of what was visited, by seed and axis ``[S, axes]``, [unit^2].

        Its point is one of an experiment with a ``spread``.
        """
        assert self.point.spread is not None
        return np.array([spatial_variance(run, self.point.spread) for run in self.runs])

    def knows(self, entry: str, scenario: str | None = None) -> bool:
        """Return whether the final evaluation has that entry; None: in the followed scenario."""
        return all(entry in summary for summary in self.summaries(scenario))

    def follows(self, entry: str) -> bool:
        """Return whether the evaluations during training have that entry."""
        return all(run.evaluations(entry) for run in self.runs)

    def steps_to(self, success: float) -> list[float | None]:
        """Return each run's environment steps at the first evaluation with that much success."""
        rates = [run.evaluations("success") for run in self.runs]
        return [min((s for s, rate in of_run if rate >= success), default=None) for of_run in rates]

    def curve(self, entry: str) -> Curve:
        """Return an entry of the followed scenario's evaluations, over environment steps.

        Raises:
            KeyError: If a run has no such entry.
        """
        series = {i: run.evaluations(entry) for i, run in enumerate(self.runs)}
        if not all(series.values()):
            raise KeyError(metrics.name(metrics.EVALUATION, self.followed, entry))
        return curve(series)


@dataclass(frozen=True)
class Finding:
    """An experiment with what there is of its outcomes, in the order of its arms and settings.

    Attributes:
        outcomes: One for each point that has a finished run.
        planned: All points, but those that arms start from.
    """

    outcomes: tuple[Outcome, ...]
    planned: tuple[Point, ...]

    @property
    def missing(self) -> str:
        """Which points lack seeds, by how many they have; empty where all runs are finished."""
        runs = {outcome.point.name: len(outcome.runs) for outcome in self.outcomes}
        few: dict[str, list[str]] = {}
        for point in self.planned:
            count, asked = runs.get(point.name, 0), len(point.seeds)
            if count < asked:
                few.setdefault(f"{count} of {asked} seeds", []).append(f'"{point.label}"')
        if len(few) == 1 and len(next(iter(few.values()))) == len(self.planned) > 1:
            return f"{next(iter(few))} of every arm"
        return "; ".join(f"{count} of {', '.join(labels)}" for count, labels in sorted(few.items()))

    @property
    def scenarios(self) -> list[str]:
        """Scenarios of any of the arms, which may have some of their own."""
        return list(dict.fromkeys(name for o in self.outcomes for name in o.scenarios))

    def arm(self, name: str) -> list[Outcome]:
        """Return the outcomes of one arm, by setting."""
        return [outcome for outcome in self.outcomes if outcome.point.arm == name]

    @property
    def arms(self) -> list[str]:
        """Names of the arms that have outcomes."""
        return list(dict.fromkeys(outcome.point.arm for outcome in self.outcomes))


Findings = Mapping[str, Finding]
"""Experiment's name to what was found."""


def gather(points: Sequence[Point], done: Sequence[Job], out: Path) -> Findings:
    """Read the runs that are done; experiments without one are left out."""
    names = {job.path: job.name for job in done}
    planned: dict[str, list[Point]] = {}
    found: dict[str, list[Outcome]] = {}
    for point in [point for point in points if point.shown and names]:
        planned.setdefault(point.experiment, []).append(point)
        paths = [run_directory(point, seed, out) for seed in point.seeds]
        if runs := tuple(Run(path, names[path]) for path in paths if path in names):
            found.setdefault(point.experiment, []).append(Outcome(point, runs))
    return {name: Finding(tuple(o), tuple(planned[name])) for name, o in found.items()}
