"""From experiments to runs: one point per arm and setting, known by its configuration; equal ones share their runs."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from math import ceil
from pathlib import Path
from typing import Any

from ..launch.store import Store, StoredRun
from ..storage.same_run import leaves
from .spec import Experiment, Overrides, Settings

Compose = Callable[[Sequence[str]], dict[str, Any]]
"""From overrides of ``rrl train`` to the resolved configuration."""

SOURCE = re.compile(r"run:([A-Za-z0-9_.-]+)")
NOT_IDENTITY = (
    "name",
    "logger*",
    "render.*",
    "trainer.seed",
    "trainer.num_seeds",
    "trainer.threads",
    "trainer.checkpoint.*",
    "trainer.evaluation.slots",
    "env.base.num_threads",
    "env.renderer*",
)
"""Dotted keys that do not decide what is learned and measured."""


@dataclass(frozen=True)
class Point:
    """One arm of one experiment at one setting: as many runs as it has groups of seeds.

    Attributes:
        experiment, arm, value: where it stands in a figure; ``value`` is None without a sweep.
        key: names the configuration without its seeds; equal for points that share their runs.
        overrides: of ``rrl train``, without seeds and directory.
        config: the resolved configuration.
        seeds: what is asked for.
        sources: points that must be trained first, by the name that the overrides use.
        whole: whether all seeds must be in one run, because others start from it.
    """

    experiment: str
    arm: str
    value: float | None
    key: str
    overrides: Overrides
    config: Mapping[str, Any] = field(repr=False, compare=False)
    seeds: tuple[int, ...]
    sources: Mapping[str, Point] = field(default_factory=dict, compare=False)
    whole: bool = False

    @property
    def name(self) -> str:
        """A directory's name: experiment, setting, arm, key."""
        setting = "" if self.value is None else f"-{self.value:g}"
        arm = re.sub(r"[^a-z0-9]+", "-", self.arm.lower()).strip("-")
        return f"{self.experiment}{setting}-{arm}-{self.key}"

    @property
    def total_steps(self) -> int:
        """Environment steps of one seed."""
        return int(self.config["trainer"]["total_steps"])


@dataclass(frozen=True)
class Job:
    """One run: an ordinary ``rrl train`` of stacked seeds in a directory of its own.

    Attributes:
        run: where it stands in the store.
        overrides: of ``rrl train``, with seeds; complete but for the directory.
        total_steps: environment steps of one seed.
        needs: runs that must be finished before.
    """

    run: StoredRun
    overrides: Overrides
    total_steps: int
    needs: tuple[StoredRun, ...] = ()

    @property
    def work(self) -> int:
        """Environment steps of all seeds."""
        return self.total_steps * len(self.run.seeds)


def plan_points(
    experiments: Sequence[Experiment], settings: Settings, compose: Compose
) -> list[Point]:
    """Every arm at every setting of every experiment, sources first.

    Raises:
        ValueError: an experiment without values at this scale, or an unknown source.
    """
    return [
        point for experiment in experiments for point in _points_of(experiment, settings, compose)
    ]


def plan_jobs(points: Sequence[Point], store: Store, stack: int, workers: int) -> list[Job]:
    """The runs that ``points`` need: those in the store as they are, new ones for the seeds that no run has.

    A seed alone equals a seed in a stack, so seeds are grouped as it suits the machine: stacked while there are more
    points than workers, spread over the workers otherwise.
    """
    unique: dict[str, Point] = {}
    for point in points:
        if point.key not in unique or len(point.seeds) > len(unique[point.key].seeds):
            unique[point.key] = point
    missing = {key: _missing(point, store) for key, point in unique.items()}
    open_points = max(1, sum(bool(seeds) for seeds in missing.values()))
    jobs: list[Job] = []
    runs: dict[str, list[StoredRun]] = {}
    for key, point in unique.items():
        parts = 1 if point.whole else ceil(workers / open_points)
        size = len(point.seeds) if point.whole else min(stack, ceil(len(missing[key]) / parts) or 1)
        runs[key] = _covering(point, store) + [
            store.place(point.name, key, group) for group in _groups(missing[key], size)
        ]
        needs = tuple(run for source in point.sources.values() for run in runs[source.key])
        for run in runs[key]:
            seeds = f"trainer.seed={run.seeds[0]}", f"trainer.num_seeds={len(run.seeds)}"
            jobs.append(Job(run, (*_directed(point, runs), *seeds), point.total_steps, needs))
    return jobs


def quoted(path: Path) -> str:
    """A path as a value in an override."""
    return "'" + str(path).replace("\\", "\\\\").replace("'", "\\'") + "'"


def _points_of(experiment: Experiment, settings: Settings, compose: Compose) -> list[Point]:
    scale = settings.scales[settings.scale]
    common = (
        *settings.overrides,
        *scale.overrides,
        *experiment.overrides,
        *experiment.scales.get(settings.scale, ()),
    )
    sweep = experiment.sweep
    if sweep and settings.scale not in sweep.values:
        raise ValueError(f"{experiment.name}: sweep.values: expected values for {settings.scale!r}")
    seeds = tuple(range(scale.seeds))

    def point(
        arm: str, overrides: Overrides, sources: Mapping[str, Point], value: float | None = None
    ) -> Point:
        setting = (f"{sweep.key}={value}",) if sweep and value is not None else ()
        overrides = (*common, *overrides, *setting)
        names = [name for override in overrides for name in SOURCE.findall(override)]
        if unknown := [name for name in names if name not in sources]:
            raise ValueError(
                f"{experiment.name}: unknown source {unknown[0]!r}; it has {sorted(sources)}"
            )
        config = compose(overrides)
        used = {name: sources[name] for name in names}
        return Point(
            experiment.name, arm, value, _key(config, used), overrides, config, seeds, used
        )

    sources: dict[str, Point] = {}
    for name, overrides in experiment.sources.items():
        made = point(name, overrides, sources)
        few = seeds[: scale.stack]
        sources[name] = Point(
            made.experiment,
            name,
            None,
            made.key,
            made.overrides,
            made.config,
            few,
            made.sources,
            whole=True,
        )
    values = sweep.values[settings.scale] if sweep else (None,)
    arms = [point(arm, o, sources, value) for value in values for arm, o in experiment.arms.items()]
    return [*sources.values(), *arms]


def _key(config: Mapping[str, Any], sources: Mapping[str, Point]) -> str:
    kept = {
        k: v
        for k, v in leaves(config).items()
        if not any(fnmatchcase(k, pattern) for pattern in NOT_IDENTITY)
    }
    text = SOURCE.sub(
        lambda found: f"run:{sources[found[1]].key}", json.dumps(kept, sort_keys=True)
    )
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _covering(point: Point, store: Store) -> list[StoredRun]:
    """Runs in the store that hold seeds of the point, finished or not."""
    return [run for run in store.runs(point.key) if set(run.seeds) & set(point.seeds)]


def _missing(point: Point, store: Store) -> list[int]:
    covered = {seed for run in store.runs(point.key) for seed in run.seeds}
    return [seed for seed in point.seeds if seed not in covered]


def _groups(seeds: Sequence[int], size: int) -> list[tuple[int, ...]]:
    """Consecutive seeds, at most ``size`` together."""
    groups: list[list[int]] = []
    for seed in seeds:
        if groups and seed == groups[-1][-1] + 1 and len(groups[-1]) < size:
            groups[-1].append(seed)
        else:
            groups.append([seed])
    return [tuple(group) for group in groups]


def _directed(point: Point, runs: Mapping[str, Sequence[StoredRun]]) -> Overrides:
    """The overrides with directories in the place of ``run:NAME``."""

    def directory(found: re.Match[str]) -> str:
        return quoted(runs[point.sources[found[1]].key][0].path)

    return tuple(SOURCE.sub(directory, override) for override in point.overrides)
