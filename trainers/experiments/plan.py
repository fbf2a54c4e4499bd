"""From experiments to runs: a point for each arm and setting, a job for each of its seeds.

The store::

    out/
        runs/
            rotation-0.1-residual-rl-3f2a91c0/   experiment, setting and arm that asked first; key
                seed-0/                          an ordinary directory of `rrl train`
        figures/                                 PNG and SVG, and the numbers behind them as CSV
        report.html                              report-NAME.html for experiments called by name
        results.md                               the same without videos, for a repository's docs

A key is a checksum of the settings that decide what is learned and measured, without the seed.
Points of equal keys share their runs. Whoever changes a default gets a new key and new runs; the
old ones stay, and nothing reads them.
"""

from __future__ import annotations

import hashlib
import json
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..launch.job import Job, one_seed
from ..storage.same_run import SEEDS, measured_settings
from .spec import Experiment, Overrides, Settings, Spread

Compose = Callable[[Sequence[str]], dict[str, Any]]
"""From overrides of ``rrl train`` to the resolved configuration."""

SOURCE = re.compile(r"run:([A-Za-z0-9._+=-]+)")


@dataclass(frozen=True)
class Point:
    """One arm of one experiment at one setting.

    Attributes:
        experiment: Name of the experiment.
        arm: Name of the arm, or of the source.
        value: The sweep's value; None without a sweep.
        key: Names the configuration without its seed.
        overrides: Overrides of ``rrl train``, without the seed.
        config: The resolved configuration.
        seeds: Seeds that are asked for.
        sources: Points that must be trained first, by the name that the overrides use.
        shown: Whether it is an arm, and not a run that arms start from.
        home: Name of the first point with this key, which the runs' directory has.
        swept: What the sweep sets, without its section.
        spread: What of its runs the variance is shown of.
    """

    experiment: str
    arm: str
    value: float | None
    key: str
    overrides: Overrides
    config: Mapping[str, Any] = field(repr=False, compare=False)
    seeds: tuple[int, ...]
    sources: Mapping[str, Point] = field(default_factory=dict, compare=False)
    shown: bool = True
    home: str = ""
    swept: str = ""
    spread: Spread | None = None

    @property
    def label(self) -> str:
        """The arm, and its setting."""
        return self.arm if self.value is None else f"{self.arm}, {self.swept} = {self.value:g}"

    @property
    def name(self) -> str:
        """A directory's name: experiment, setting, arm, key."""
        setting = "" if self.value is None else f"-{self.value:g}"
        arm = re.sub(r"[^a-z0-9]+", "-", self.arm.lower()).strip("-")
        return f"{self.experiment}{setting}-{arm}-{self.key}"


def plan_points(
    experiments: Sequence[Experiment], settings: Settings, compose: Compose
) -> list[Point]:
    """Return every arm at every setting of every experiment, sources first.

    Raises:
        ValueError: If an experiment has no values at this scale or an unknown source.
    """
    homes: dict[str, str] = {}
    return [point for e in experiments for point in _points_of(e, settings, compose, homes)]


def plan_jobs(points: Sequence[Point], out: Path) -> list[Job]:
    """Return the runs that ``points`` need: sources first, and every point's first seed first.

    What starts from a source starts with seed k from the source's seed k. So nothing is chosen, the
    runs of an arm stay independent, and their spread holds that of the policies they start from.
    (The paper used one policy: its spread is that of the second training alone.)
    """
    jobs: dict[Path, Job] = {}
    for point in points:
        for seed in point.seeds:
            path = run_directory(point, seed, out)
            needs = {
                f"run:{name}": run_directory(source, seed, out)
                for name, source in point.sources.items()
            }
            config = replaced(one_seed(point.config, seed), needs)
            jobs.setdefault(path, Job(path, config, tuple(needs.values())))
    return sorted(jobs.values(), key=lambda job: job.config["trainer"]["seed"])


def plan_spreads(points: Sequence[Point], out: Path) -> dict[Path, list[Spread]]:
    """Return by run what its variance is shown of."""
    spreads: dict[Path, list[Spread]] = {}
    for point in points:
        for path in (run_directory(point, seed, out) for seed in point.seeds):
            spreads.setdefault(path, []).extend([point.spread] if point.spread else [])
    return spreads


def run_directory(point: Point, seed: int, out: Path) -> Path:
    """Return where a run of a point is, or will be, in the store ``out``."""
    present = sorted((out / "runs").glob(f"*-{point.key}"))
    return (present[0] if present else out / "runs" / (point.home or point.name)) / f"seed-{seed}"


def command(point: Point, seed: int, out: Path) -> str:
    """Return the command that makes a run of a point anywhere."""

    def directory(found: re.Match[str]) -> str:
        path = str(run_directory(point.sources[found[1]], seed, out))
        escaped = path.replace("\\", "\\\\").replace("'", "\\'")
        return f"'{escaped}'"

    overrides = [SOURCE.sub(directory, override) for override in point.overrides]
    return shlex.join(["rrl", "train", *overrides, f"trainer.seed={seed}"])


def _points_of(
    experiment: Experiment, settings: Settings, compose: Compose, homes: dict[str, str]
) -> list[Point]:
    """Return an experiment's points; ``homes`` gets the first name of every key."""
    scale, sweep = settings.scales[settings.scale], experiment.sweep
    common = (*settings.overrides, *scale.overrides, *experiment.overrides)
    common += experiment.scales.get(settings.scale, ())
    if unknown := sorted(set(experiment.scales) - set(settings.scales)):
        raise ValueError(
            f"{experiment.name}.scales: expected some of {', '.join(settings.scales)}, "
            f"got {unknown[0]!r}"
        )
    if sweep and settings.scale not in sweep.values:
        raise ValueError(
            f"{experiment.name}.sweep.values: expected values for {settings.scale!r}, "
            f"got {sorted(sweep.values)}"
        )

    def point(arm: str, overrides: Overrides, value: float | None, shown: bool) -> Point:
        setting = (f"{sweep.key}={value}",) if sweep and value is not None else ()
        overrides = (*common, *overrides, *setting)
        names = [name for override in overrides for name in SOURCE.findall(override)]
        if unknown := [name for name in names if name not in sources]:
            raise ValueError(
                f"{experiment.name}: expected sources of {sorted(sources)}, got {unknown[0]!r}"
            )
        config, used = compose(overrides), {name: sources[name] for name in names}
        if shown:
            _check(experiment, config)
        key, seeds = _key(config, used), tuple(range(settings.seeds_of(experiment)))
        asked = arm, value, key, overrides, config, seeds, used, shown
        swept = sweep.name if sweep else ""
        made = Point(
            experiment.name, *asked, swept=swept, spread=experiment.spread if shown else None
        )
        return replace(made, home=homes.setdefault(key, made.name))

    sources: dict[str, Point] = {}
    for name, overrides in experiment.sources.items():
        sources[name] = point(name, overrides, None, False)
    values = sweep.values[settings.scale] if sweep else (None,)
    arms = [
        point(arm, o, value, True) for value in values for arm, o in experiment.all_arms.items()
    ]
    return [*sources.values(), *arms]


def _check(experiment: Experiment, config: Mapping[str, Any]) -> None:
    """Refuse runs that do not log what the experiment shows of them."""
    trainer, known = config["trainer"], config["env"].get("metrics") or {}
    every, total = trainer["evaluation"]["every"], trainer["total_steps"]
    loggers = {
        name: node["_target_"] for name, node in (config.get("logger") or {}).items() if node
    }
    if not any(target.endswith(".CSVLogger") for target in loggers.values()):
        raise ValueError(
            f"{experiment.name}: expected csv among the loggers, as what is shown of a run stands "
            f"in its metrics.csv, got {', '.join(loggers) or 'none'}"
        )
    if experiment.figure in ("curves", "tasks", "changes") and not every:
        raise ValueError(
            f"{experiment.name}: expected trainer.evaluation.every above 0 for curves, got 0"
        )
    for at in experiment.evaluated_at:
        if not every or at % every or at > total:
            raise ValueError(
                f"{experiment.name}.evaluated_at: expected multiples of trainer.evaluation.every "
                f"({every}) up to trainer.total_steps ({total}), got {at}"
            )
    if experiment.spread is not None:
        if (entry := experiment.spread.entry) not in (inputs := config["env"]["inputs"]):
            raise ValueError(
                f"{experiment.name}.spread.entry: expected one of env.inputs "
                f"({', '.join(sorted(inputs))}), got {entry!r}"
            )
        if trainer["buffer_capacity"] < total:
            raise ValueError(
                f"{experiment.name}.spread: expected a trainer.buffer_capacity of all steps of a "
                f"run ({total}), got {trainer['buffer_capacity']}"
            )
    if experiment.metric is not None and experiment.metric not in known:
        choices = ", ".join(sorted(known)) or "none"
        raise ValueError(
            f"{experiment.name}.metric: expected one of env.metrics ({choices}), "
            f"got {experiment.metric!r}"
        )


def _key(config: Mapping[str, Any], sources: Mapping[str, Point]) -> str:
    measured = measured_settings(config, without=SEEDS)
    text = json.dumps(measured, sort_keys=True)
    text = SOURCE.sub(lambda found: f"run:{sources[found[1]].key}", text)
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def replaced(config: Any, paths: Mapping[str, Path]) -> Any:
    """Return a configuration with a path in the place of each value that ``paths`` has."""
    if isinstance(config, Mapping):
        return {key: replaced(child, paths) for key, child in config.items()}
    return str(paths[config]) if isinstance(config, str) and config in paths else config
