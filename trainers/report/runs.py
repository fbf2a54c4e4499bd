"""What runs left in their directories, and which of them differ by the seed alone."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from ..loggers import metrics
from ..loggers.csv_file import read_metrics
from ..metric_names import EPISODES
from ..storage.run_files import CONFIG_FILE, METRICS, RESULTS, VERSIONS, VIDEOS, seed_directories
from ..storage.same_run import SEEDS, measured_settings
from .curves import Curve, Floats, counts_at, joined
from .panels import FOLLOWED, Declared

log = logging.getLogger(__name__)

Record = Mapping[str, Mapping[str, Any]]
"""What ``results.json`` holds of a scenario: ``summary`` and ``episodes``."""

NEEDED: Mapping[str, type] = {
    "arm": str,
    "env.name": str,
    "env.scenarios": dict,
    "trainer.seed": int,
    "trainer.total_steps": int,
    "trainer.evaluation.episodes": int,
    "algorithm.agent._target_": str,
}
"""What a configuration has to have for its run to be shown."""


@dataclass(frozen=True)
class Run:
    """A run's directory.

    Attributes:
        path: The directory.
        label: Tells it from the runs that it is shown with.
        ended: The final evaluation, of a run that has not written it yet.
    """

    path: Path
    label: str
    ended: Mapping[str, Record] | None = field(default=None, repr=False, compare=False)

    @cached_property
    def config(self) -> dict[str, Any]:
        """The resolved configuration."""
        return _config(self.path)

    @cached_property
    def metrics(self) -> dict[str, list[tuple[int, float]]]:
        """Every metric that was logged; empty where the run kept no ``metrics.csv``."""
        return self._read(METRICS, lambda path: read_metrics(path.parent))

    @cached_property
    def results(self) -> Mapping[str, Record]:
        """The final evaluation by scenario; empty while the run is not finished."""
        return self.ended or self._read(RESULTS, _records)

    @cached_property
    def versions(self) -> dict[str, str]:
        """Package versions that the run was made with."""
        return self._read(VERSIONS, _json)

    @property
    def seed(self) -> int:
        """The seed."""
        return int(self.config["trainer"]["seed"])

    @property
    def followed(self) -> str:
        """The scenario that is evaluated during training."""
        return str(next(iter(self.config["env"]["scenarios"])))

    @property
    def env_steps(self) -> int:
        """Environment steps, as far as they are logged."""
        return max((points[-1][0] for points in self.metrics.values()), default=0)

    @property
    def seconds(self) -> float:
        """Wall time that was spent in the run's loop and its evaluations, over all its sessions."""
        return sum(map(self.seconds_of, metrics.WHOLE_SECTIONS))

    def seconds_of(self, part: str) -> float:
        """Wall time of one part of the loop."""
        return sum(value for _, value in self.metrics.get(metrics.name(metrics.TIME, part), ()))

    @property
    def videos(self) -> list[Path]:
        """Rendered episodes."""
        return _videos_in(self.path)

    def evaluations(self, entry: str) -> list[tuple[int, float]]:
        """Return an entry of the followed scenario's evaluations: ``(env_steps, value)`` in order.

        Empty where it was not logged.
        """
        return self.metrics.get(metrics.name(metrics.EVALUATION, self.followed, entry), [])

    def summary(self, scenario: str | None = None) -> Mapping[str, float]:
        """Return the final evaluation in a scenario; None: the followed one.

        Raises:
            KeyError: If the run is not finished or does not know the scenario.
        """
        return self.results[scenario or self.followed]["summary"]

    def _read(self, name: str, parse: Callable[[Path], Any]) -> Any:
        path = self.path / name
        try:
            return parse(path) if path.is_file() else {}
        except (OSError, ValueError) as error:
            log.warning("%s cannot be read and is left out: %s", path, error)
            return {}


def declared_in(config: Mapping[str, Any]) -> Declared:
    """Return what a configuration says of the quantities that its environment reports, by name."""
    return {name: how or {} for name, how in (config["env"].get("metrics") or {}).items()}


@dataclass(frozen=True)
class Group:
    """Runs that differ by the seed alone; a run by itself is a group too.

    Attributes:
        label: Tells it from the groups that it is shown with.
        runs: In the order of their seeds.
    """

    label: str
    runs: tuple[Run, ...]

    @property
    def config(self) -> dict[str, Any]:
        """The configuration of the first run."""
        return self.runs[0].config

    @property
    def followed(self) -> str:
        """The scenario that is evaluated during training."""
        return self.runs[0].followed

    def followed_episodes(self, steps: Floats) -> Floats:
        """Return the episodes of the evaluations after these steps, ``[T]``."""
        logged = [run.evaluations(EPISODES) for run in self.runs]
        return counts_at(steps, logged, int(self.config["trainer"]["evaluation"]["episodes"]))

    @property
    def declared(self) -> Declared:
        """What the environment says of the quantities that it reports, by name."""
        return declared_in(self.config)

    @cached_property
    def results(self) -> dict[str, list[Record]]:
        """The final evaluations by scenario, one for each run that is finished."""
        names = dict.fromkeys(name for run in self.runs for name in run.results)
        return {n: [r.results[n] for r in self.runs if n in r.results] for n in names}

    @property
    def videos(self) -> list[tuple[str, Path]]:
        """Rendered episodes, each with the label of what it shows: of all seeds, then of each."""
        parents = dict.fromkeys(run.path.parent for run in self.runs)
        folders = [p for p in parents if set(seed_directories(p)) & {run.path for run in self.runs}]
        common = [(self.label, video) for folder in folders for video in _videos_in(folder)]
        return common + [(run.label, video) for run in self.runs for video in run.videos]

    def curve(self, metric: str) -> Curve | None:
        """Return a metric over environment steps; None if no run logged it.

        ``{followed}`` in its name stands for the scenario that is evaluated during training.
        """
        name = metric.replace(FOLLOWED, self.followed)
        series = {k: run.metrics[name] for k, run in enumerate(self.runs) if name in run.metrics}
        if not series:
            return None
        return replace(joined(series), seeds=tuple(self.runs[k].seed for k in series))

    def metrics_of(self, *group: str) -> list[str]:
        """Return the names of the logged metrics of a group, without the group."""
        prefix = metrics.name(*group, "")
        names = dict.fromkeys(name for run in self.runs for name in run.metrics)
        return [name.removeprefix(prefix) for name in names if name.startswith(prefix)]


def find_runs(paths: Sequence[Path]) -> list[Run]:
    """Return the runs at ``paths``; a folder that is no run stands for all runs below it.

    A run whose configuration cannot be read is named in a warning and left out.

    Raises:
        FileNotFoundError: If there is none at one of them.
    """
    found: list[Path] = []
    for path in paths:
        below = [p for p in _run_dirs(path) if _readable(p)]
        if not below:
            raise FileNotFoundError(
                f"{path}: expected the directory of a run, or a folder of runs, "
                f"got no {CONFIG_FILE}"
            )
        found += below
    found = list(dict.fromkeys(p.resolve() for p in found))
    names = [str(_config(path).get("name", path.name)) for path in found]
    return [Run(p, label) for p, label in zip(found, _labels(names, found), strict=True)]


def group_runs(runs: Sequence[Run]) -> list[Group]:
    """Put runs together that differ in nothing measured but the seed."""
    groups: dict[tuple[str, int], list[Run]] = {}
    for run in runs:
        text, again = json.dumps(measured_settings(run.config, SEEDS), sort_keys=True), 0
        while any(run.seed == other.seed for other in groups.get((text, again), ())):
            again += 1  # the same seed once more tells nothing new
        groups.setdefault((text, again), []).append(run)
    sets = [tuple(sorted(found, key=lambda run: run.seed)) for found in groups.values()]
    names = [str(found[0].config.get("name", found[0].path.name)) for found in sets]
    paths = [_common([run.path for run in found]) for found in sets]
    return [Group(n, found) for n, found in zip(_labels(names, paths), sets, strict=True)]


def _config(path: Path) -> dict[str, Any]:
    return _mapping(yaml.safe_load((path / CONFIG_FILE).read_text(encoding="utf-8")))


def _readable(path: Path) -> bool:
    try:
        config = _config(path)
        for key, kind in NEEDED.items():
            found: Any = config
            for part in key.split("."):
                found = found.get(part) if isinstance(found, Mapping) else None
            if not isinstance(found, kind) or found == {}:
                raise ValueError(f"{key}: expected {kind.__name__}, got {found!r}")
    except (OSError, ValueError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())
        log.warning("%s cannot be read, the run is left out: %s", path / CONFIG_FILE, reason)
        return False
    return True


def _mapping(content: Any) -> dict[str, Any]:
    if not isinstance(content, dict):
        raise ValueError(f"expected entries by name, got {content!r}")
    return content


def _json(path: Path) -> dict[str, Any]:
    return _mapping(json.loads(path.read_text(encoding="utf-8")))


def _records(path: Path) -> dict[str, Record]:
    records = _json(path)
    for scenario, record in records.items():
        if not {"summary", "episodes"} <= _mapping(record).keys():
            raise ValueError(f"{scenario}: expected summary and episodes, got {list(record)}")
    return records


def _run_dirs(folder: Path) -> Iterator[Path]:
    """The folder, if it is a run, or all runs below it; nothing hidden, nor what a run contains."""
    for name, folders, files in os.walk(folder):
        path = Path(name)
        found = seed_directories(path) or ([path] if CONFIG_FILE in files else [])
        yield from found
        folders[:] = [] if found else sorted(f for f in folders if not f.startswith("."))


def _labels(names: Sequence[str], paths: Sequence[Path]) -> list[str]:
    """Names where they tell the runs apart, else the part of the paths that does."""
    if len(set(names)) == len(names):
        return list(names)
    common = _common(paths)
    common = common.parent if common in paths else common
    labels = [str(path.relative_to(common)) for path in paths]
    if len(set(labels)) == len(labels):
        return labels
    return [f"{name} ({number})" for number, name in enumerate(labels, 1)]


def _common(paths: Sequence[Path]) -> Path:
    return Path(os.path.commonpath(paths))


def _videos_in(folder: Path) -> list[Path]:
    return sorted(p for p in (folder / VIDEOS).glob("*") if p.suffix in (".mp4", ".gif"))
