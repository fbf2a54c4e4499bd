"""What the runs of a point came to, its groups of seeds put together again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..evaluation.statistics import Interval, mean_interval, success_interval
from ..launch.store import Store
from ..loggers import metrics
from ..report.curves import Curve, curve
from ..report.runs import Group, Run
from .plan import Point

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """The finished runs of one point.

    Attributes:
        point: arm, setting, configuration.
        runs: one for each group of seeds.
    """

    point: Point
    runs: tuple[Run, ...]

    @cached_property
    def seeds(self) -> list[int]:
        """Seeds that are finished, of those that were asked for."""
        return [run.seed for run in self._runs]

    @property
    def followed(self) -> str:
        """The scenario that was evaluated during training."""
        return self.runs[0].followed

    @property
    def followed_episodes(self) -> int:
        """Episodes of an evaluation during training."""
        return Group("", self.runs).followed_episodes

    @property
    def scenarios(self) -> list[str]:
        """Scenarios of the final evaluation."""
        return list(self.runs[0].results)

    @property
    def acts_alone(self) -> bool:
        """Whether the policy has no controller below it."""
        return str(self.point.config["controller"]["_target_"]).endswith(".ZeroController")

    @cached_property
    def episodes(self) -> int:
        """Frozen episodes of each scenario in the final evaluation."""
        return len(self.runs[0].results[self.followed]["episodes"]["return"])

    def final(self, entry: str, scenario: str | None = None) -> Floats:
        """Return one entry of the final evaluation's summary, by seed ``[S]``."""
        found = [run.results[scenario or self.followed]["summary"] for run in self._runs]
        return np.array([summary[entry] for summary in found])

    def interval(self, entry: str, scenario: str | None = None) -> Interval:
        """Return the 95 % interval of an entry's mean over runs; the controller's over episodes."""
        values = self.final(entry, scenario)
        if entry not in ("success", "controller_success"):
            return mean_interval(values)
        counts = np.rint(values * self.episodes).astype(int).tolist()
        return success_interval(counts if entry == "success" else counts[:1], self.episodes)

    def knows(self, entry: str) -> bool:
        """Return whether the final evaluation has that entry."""
        return entry in self.runs[0].results[self.followed]["summary"]

    def curve(self, entry: str) -> Curve:
        """Return an entry of the evaluations during training.

        Raises:
            KeyError: If a run has not logged it.
        """
        name = metrics.name(metrics.EVALUATION, self.followed, entry)
        return curve({run.seed: run.record[name] for run in self._runs})

    @property
    def _runs(self) -> list[Run]:
        wanted = [run for run in self.runs if run.seed in self.point.seeds]
        return sorted(wanted, key=lambda run: run.seed)


@dataclass(frozen=True)
class Finding:
    """An experiment with what there is of its outcomes, in the order of its arms and settings."""

    name: str
    outcomes: tuple[Outcome, ...]

    def arm(self, name: str) -> list[Outcome]:
        """The outcomes of one arm, by setting."""
        return [outcome for outcome in self.outcomes if outcome.point.arm == name]

    @property
    def arms(self) -> list[str]:
        """Names of the arms that have outcomes."""
        return list(dict.fromkeys(outcome.point.arm for outcome in self.outcomes))


Findings = Mapping[str, Finding]
"""Experiment's name to what was found."""


def gather(points: Sequence[Point], store: Store) -> Findings:
    """Read what is finished; points without a finished run are left out, and so are runs that others start from."""
    found: dict[str, list[Outcome]] = {}
    for point in points:
        outcomes = found.setdefault(point.experiment, [])
        runs = [
            run
            for run in store.runs(point.key)
            if run.finished and set(run.seeds) & set(point.seeds)
        ]
        if runs and not point.whole:
            outcomes.append(Outcome(point, tuple(Run(run.path, run.name) for run in runs)))
    return {name: Finding(name, tuple(outcomes)) for name, outcomes in found.items()}
