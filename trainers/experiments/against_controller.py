"""How an arm stands against its controller: what its runs hand over, at every evaluation."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..evaluation.sequential import margin_unit
from ..evaluation.statistics import Interval
from ..loggers import metrics
from ..metric_names import ACCEPTED, CONTROLLER, decimals
from ..report.runs import Run
from ..report.tables import gain, handed_over, success_cells
from .figure_style import unit_of
from .outcomes import ROUNDING, Outcome

HEADER = [
    "task",
    "measured by",
    "controller",
    "latest policy",
    "handed over",
    "gain of what is handed over",
    "least gain at an evaluation",
    "verdict",
    "wall time of a run",
    "packages",
]
READING = (
    "Brackets hold 95 % intervals: of the controller over its episodes; of policies over runs "
    "and episodes (success, beta-binomial) or over runs (return, Student's t); of the gain over "
    "runs and episodes, paired where the episodes are frozen. Not worse: at every evaluation of "
    "every run during training, and on the final episodes in the mean of the runs, what is handed "
    "over is at most the allowed difference below the controller (see `trainer.acceptance.margin`; "
    "of returns it is a share of the range of the controller's). Better: beyond that the interval "
    "of the final gain is above zero. Unknown: one of these returns is not a number."
)
"""How the rows are to be read."""


@dataclass(frozen=True)
class Standing:
    """What the runs of an arm hand over, against their controller; in success rate or return.

    What is exactly the margin below the controller is not worse.

    Attributes:
        entry: ``success`` where the environment reports it, else ``return``.
        margin: How much less than the controller's still counts as not worse: the share
            ``trainer.acceptance.margin`` of success, or of the range of the controller's returns;
            see :func:`~rrl.trainers.evaluation.sequential.margin_unit`.
        gain: Of the final evaluation, mean of the runs.
        interval: Its 95 % interval.
        least: The least gain of any run at any evaluation during training.
    """

    entry: str
    margin: float
    gain: float
    interval: Interval
    least: float

    @property
    def verdict(self) -> str:
        """``better``, ``not worse``, ``worse``, or ``unknown`` where a return is not a number."""
        if math.isnan(self.least + self.gain + self.margin):
            return "unknown"
        if min(self.least, self.gain) < -self.margin * (1 + ROUNDING):
            return "worse"
        return "better" if self.interval[0] > 0 else "not worse"


def standing(outcome: Outcome) -> Standing:
    """Judge an arm.

    Raises:
        KeyError: If the runs logged no evaluation during training.
    """
    entry = outcome.measured_by
    records = [handed_over(run.results[outcome.followed]) for run in outcome.runs]
    share = float(outcome.point.config["trainer"]["acceptance"]["margin"])
    alone = [record["episodes"][CONTROLLER + entry] for record in records]
    scale = 1.0 if entry == "success" else margin_unit(np.array(alone, dtype=float))
    least = float(np.min([change for run in outcome.runs for change in _changes(run, entry)]))
    return Standing(entry, share * scale, *gain(records), least)


def standing_row(outcome: Outcome) -> list[str]:
    """Return an arm's row for ``HEADER``."""
    found = standing(outcome)
    unit = unit_of(found.entry)
    records = [run.results[outcome.followed] for run in outcome.runs]
    controller, latest, *_ = success_cells(records)
    _, accepted, change, *_ = success_cells(list(map(handed_over, records)))
    cells = [controller, latest, accepted, change]
    least, allowed = found.least * unit, -found.margin * unit
    digits = decimals(least, allowed)
    minutes = np.mean([run.seconds for run in outcome.runs]) / 60
    cells += [f"{least:+.{digits}f} (allowed: {allowed:.{digits}f})", found.verdict]
    cells += [f"{minutes:.1f} min", _packages(outcome)]
    return [outcome.point.label, found.entry, *cells]


def _changes(run: Run, entry: str) -> Iterator[float]:
    """What is handed over less the controller, at each evaluation during training."""
    prefixes = (CONTROLLER, ACCEPTED, "")
    controller, accepted, latest = (run.evaluations(prefix + entry) for prefix in prefixes)
    if not controller:
        raise KeyError(metrics.name(metrics.EVALUATION, run.followed, CONTROLLER + entry))
    for (_, alone), (_, value) in zip(controller, accepted or latest, strict=True):
        yield value - alone


def _packages(outcome: Outcome) -> str:
    """Name the versions of the packages that the environment says it needs."""
    names = outcome.point.config["env"].get("packages") or ()
    known = {name: [run.versions.get(name, "unknown") for run in outcome.runs] for name in names}
    return ", ".join(f"{name} {' or '.join(dict.fromkeys(v))}" for name, v in known.items())
