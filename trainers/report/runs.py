"""What a run left in its directory, read back for comparison."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from ..loggers import metrics, read_metrics
from ..storage.run_files import (
    CONFIG_FILE,
    METRICS,
    RESULTS,
    VERSIONS,
    VIDEOS,
    seed_directories,
)
from .curves import Curve, Series, curve

Summaries = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Scenario, seed, entry of a comparison's summary."""


@dataclass(frozen=True)
class Run:
    """A run's directory.

    Attributes:
        path: the directory.
        label: tells it from the other runs it is shown with.
    """

    path: Path
    label: str

    @cached_property
    def config(self) -> dict[str, Any]:
        """The resolved configuration."""
        return dict(yaml.safe_load((self.path / CONFIG_FILE).read_text(encoding="utf-8")))

    @cached_property
    def record(self) -> Mapping[str, Series]:
        """Every metric that was logged; empty where the run kept no ``metrics.csv``."""
        return read_metrics(self.path) if (self.path / METRICS).is_file() else {}

    @cached_property
    def results(self) -> Summaries:
        """The final evaluation; empty while the run is not finished."""
        return self._json(RESULTS)

    @cached_property
    def versions(self) -> dict[str, str]:
        """Package versions that the run was made with."""
        return self._json(VERSIONS)

    @property
    def seeds(self) -> list[int]:
        """Seeds that train side by side."""
        trainer = self.config["trainer"]
        return list(range(trainer["seed"], trainer["seed"] + trainer["num_seeds"]))

    @property
    def followed(self) -> str:
        """The scenario that is evaluated during training."""
        return next(iter(self.config["env"]["scenarios"]))

    @property
    def env_steps(self) -> int:
        """Environment steps of one seed, as far as they are logged."""
        return max(
            (points[-1][0] for series in self.record.values() for points in series.values()),
            default=0,
        )

    @property
    def videos(self) -> list[Path]:
        """Rendered episodes."""
        return sorted(p for p in (self.path / VIDEOS).glob("*") if p.suffix in (".mp4", ".gif"))

    def curve(self, metric: str) -> Curve | None:
        """A metric over environment steps, ``{followed}`` standing for the scenario; None if it was not logged."""
        series = self.record.get(metric.format(followed=self.followed))
        return curve(series) if series else None

    def metrics_of(self, group: str) -> list[str]:
        """Names of the logged metrics of a group, without those of time's bookkeeping."""
        return [name for name in self.record if name.startswith(metrics.name(group, ""))]

    def _json(self, name: str) -> Any:
        path = self.path / name
        return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def find_runs(paths: Sequence[Path]) -> list[Run]:
    """The runs at ``paths``; a folder that is no run itself stands for all runs below it.

    Raises:
        FileNotFoundError: if there is none at one of them.
    """
    found: list[Path] = []
    for path in paths:
        alone = (path / CONFIG_FILE).is_file() and not seed_directories(path)
        below = [path] if alone else seed_directories(path) or _below(path)
        if not below:
            raise FileNotFoundError(
                f"{path}: no {CONFIG_FILE}; expected the directory of a run, or a folder of runs"
            )
        found += below
    found = list(dict.fromkeys(p.resolve() for p in found))
    return [Run(path, label) for path, label in zip(found, _labels(found), strict=True)]


def _below(folder: Path) -> list[Path]:
    """Directories of runs, without the command line's hidden copy of the configuration as it was composed."""
    parents = sorted(path.parent for path in folder.rglob(CONFIG_FILE))
    return [
        path
        for path in parents
        if not any(part.startswith(".") for part in path.relative_to(folder).parts)
        and not seed_directories(path)
    ]


def _labels(paths: Sequence[Path]) -> list[str]:
    """The runs' own names where they tell the runs apart, else the part of the paths that does."""
    names = [str(Run(path, "").config.get("name", path.name)) for path in paths]
    if len(set(names)) == len(names):
        return names
    common = Path(os.path.commonpath(paths))
    return [str(path.relative_to(common)) for path in paths]
