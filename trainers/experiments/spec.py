"""What an experiment is: arms, settings and scales, as its YAML file says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ..configuration.schema import PlainName, explain
from ..settings import Positive

Overrides = tuple[str, ...]
FOLDER = "experiment"
DEFAULTS = "reproduce.yaml"
OF_RUNS = {"overrides", "sources", "arms", "tasks", "changes", "sweep", "scales"}
"""What says which runs there are."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Sweep(_Section):
    """One key of the configuration, set to one value after another.

    Attributes:
        key: The dotted key.
        label: What it is, with its unit, for an axis.
        values: By scale.
    """

    key: str
    label: str
    values: dict[str, tuple[int | float, ...]]

    @property
    def name(self) -> str:
        """The key without its section."""
        return self.key.rpartition(".")[2]


class Spread(_Section):
    """An entry whose variance over all steps of a run is shown.

    Attributes:
        name: What it is, as in ``position``; columns and the kept file are called after it.
        entry: Its key among ``env.inputs``.
        axes: Names of its numbers.
        unit: Of what is shown.
        factor: From the entry's unit to this one.
    """

    name: PlainName
    entry: str
    axes: Annotated[tuple[PlainName, ...], Field(min_length=1)]
    unit: PlainName
    factor: Annotated[float, Field(gt=0)] = 1.0

    @property
    def file(self) -> str:
        """Where a run that is kept without its log has the variance."""
        return f"{self.name}s.json"

    @property
    def columns(self) -> list[str]:
        """Of the variance by axis."""
        return [f"{self.name}_variance_{axis}_{self.unit}2" for axis in self.axes]


class Experiment(_Section):
    """Arms x settings x seeds, and what is drawn of them.

    Attributes:
        name: Name of the file.
        title: What is shown.
        paper: Where the paper has it; None: nowhere.
        figure: What is drawn: ``curves``, ``sweep``, ``table``, ``spread``; ``front``: success
            against ``metric``; ``tasks``: every arm is a task of its own, with its own controller;
            ``changes``: every change against the first of them, on every task.
        metric: What ``front`` draws success against: a quantity that the environment reports.
        spread: What ``spread`` shows the variance of.
        by_name: Whether it is left out where no experiment is named.
        seeds: How many, instead of the scale's number.
        evaluated_at: Environment steps whose evaluations become a table.
        runs_of: Another experiment whose runs these are.
        overrides: Overrides of ``rrl train``, for every run.
        sources: Runs that others start from, by name: ``key=run:NAME`` in an arm becomes the
            directory of that run with the same seed.
        arms: Name to overrides.
        tasks: Name to overrides; on every task there is an arm ``TASK, CHANGE`` for each of
            ``changes``, before those of ``arms``.
        changes: Name to overrides.
        sweep: Settings of every arm.
        scales: Further overrides, by scale.
    """

    name: str
    title: str
    paper: str | None = None
    figure: Literal["curves", "sweep", "table", "spread", "front", "tasks", "changes"]
    metric: PlainName | None = None
    spread: Spread | None = None
    by_name: bool = False
    seeds: Positive | None = None
    evaluated_at: tuple[Positive, ...] = ()
    runs_of: str | None = None
    overrides: Overrides = ()
    sources: dict[PlainName, Overrides] = {}
    arms: dict[str, Overrides] = {}
    tasks: dict[str, Overrides] = {}
    changes: dict[str, Overrides] = {}
    sweep: Sweep | None = None
    scales: dict[str, Overrides] = {}

    @property
    def heading(self) -> str:
        """Title, and where the paper has it."""
        return f"{self.title} ({self.paper})" if self.paper else self.title

    @property
    def all_arms(self) -> dict[str, Overrides]:
        """Every change on every task, and the other arms."""
        crossed = {
            arm_of(task, change): (*of_task, *of_change)
            for task, of_task in self.tasks.items()
            for change, of_change in self.changes.items()
        }
        return {**crossed, **self.arms}

    @property
    def all_changes(self) -> list[str]:
        """The changes of every task, then those that ``arms`` makes on one of them."""
        arms = [arm.removeprefix(arm_of(task, "")) for arm in self.arms for task in self.tasks]
        own = [change for change in arms if change not in self.arms]
        return list(dict.fromkeys([*self.changes, *own]))

    @model_validator(mode="after")
    def _check(self) -> Experiment:
        if bool(self.tasks) != bool(self.changes):
            got = "tasks" if self.tasks else "changes"
            raise ValueError(f"expected tasks and changes, or neither, got {got} alone")
        if bool(self.all_arms) == bool(self.runs_of):
            got = "both" if self.runs_of else "neither"
            raise ValueError(f"expected either arms or runs_of, got {got}")
        if own := sorted(self.model_fields_set.intersection(OF_RUNS)) if self.runs_of else []:
            raise ValueError(f"expected no {own[0]} beside runs_of, which brings them")
        if self.figure == "sweep" and not (self.sweep or self.runs_of):
            raise ValueError("figure: sweep: expected a sweep, got none")
        if self.figure == "changes":
            self._check_changes()
        if (self.figure == "front") != (self.metric is not None):
            raise ValueError(
                "metric: expected one with figure: front, and only there, got "
                f"{self.metric!r} with figure: {self.figure}"
            )
        if (self.figure == "spread") != (self.spread is not None):
            raise ValueError(
                "spread: expected it with figure: spread, and only there, got "
                f"{'it' if self.spread else 'none'} with figure: {self.figure}"
            )
        return self

    def _check_changes(self) -> None:
        if not self.tasks:
            raise ValueError("figure: changes: expected tasks and changes, got none")
        if len(self.all_changes) < 2:
            raise ValueError(f"changes: expected at least two to compare, got {self.all_changes}")
        for arm in self.arms:
            if not arm.startswith(tuple(arm_of(task, "") for task in self.tasks)):
                raise ValueError(f"arms: expected TASK, CHANGE of one of the tasks, got {arm!r}")


def arm_of(task: str, change: str) -> str:
    """Return the name of the arm that makes a change on a task."""
    return f"{task}, {change}"


class Scale(_Section):
    """How much of everything: seeds, overrides."""

    seeds: Positive
    overrides: Overrides = ()


class Settings(_Section):
    """What ``rrl reproduce`` reads: :file:`configs/reproduce.yaml` and its command line."""

    scale: str
    seeds: Annotated[int, Field(ge=1, strict=True)] | None = None
    launcher: Literal["local", "ray"]
    workers: Annotated[int, Field(ge=0, strict=True)] | None
    out: str
    data: str | None = None
    overrides: Overrides = ()
    scales: dict[str, Scale]

    @model_validator(mode="after")
    def _check(self) -> Settings:
        if self.scale not in self.scales:
            raise ValueError(f"scale: expected one of {', '.join(self.scales)}, got {self.scale!r}")
        return self

    def seeds_of(self, experiment: Experiment) -> int:
        """Return how many seeds an experiment has; the command line's number comes first."""
        return self.seeds or experiment.seeds or self.scales[self.scale].seeds


def load_experiments(names: Sequence[str], folders: Sequence[Path]) -> list[Experiment]:
    """Read experiments by name; none named: all but those that have to be named.

    Args:
        names: Names of the files, without ``.yaml``.
        folders: Folders of configurations; the first one that has the file is read.

    Raises:
        ValueError: If a name is unknown, or a file is no experiment.
    """
    known: dict[str, Path] = {}
    for folder in reversed(folders):
        known |= {path.stem: path for path in sorted((folder / FOLDER).glob("*.yaml"))}
    if unknown := [name for name in names if name not in known]:
        choices = ", ".join(sorted(known))
        raise ValueError(f"experiment: expected one of {choices}, got {', '.join(unknown)}")
    found = [_read(name, known[name]) for name in dict.fromkeys(names or known)]
    return [_with_runs(e, known) for e in found if names or not e.by_name]


def load_settings(folders: Sequence[Path], changes: dict[str, Any]) -> Settings:
    """Read the command's settings and change some.

    Raises:
        ValueError: If keys or values are unknown.
    """
    path = next(folder / DEFAULTS for folder in folders if (folder / DEFAULTS).is_file())
    changeable = [name for name in Settings.model_fields if name not in ("overrides", "scales")]
    if unknown := sorted(set(changes) - set(changeable)):
        choices = ", ".join(changeable)
        raise ValueError(f"setting: expected one of {choices}, got {', '.join(unknown)}")
    return _validated(Settings, {**_content(path), **changes}, path.name)


def _with_runs(experiment: Experiment, known: Mapping[str, Path]) -> Experiment:
    """Return an experiment with the runs of the one that it names, if it names one."""
    if experiment.runs_of is None:
        return experiment
    if experiment.runs_of not in known:
        choices = ", ".join(sorted(known))
        raise ValueError(
            f"{experiment.name}.runs_of: expected one of {choices}, got {experiment.runs_of!r}"
        )
    other = _read(experiment.runs_of, known[experiment.runs_of])
    if other.runs_of:
        raise ValueError(
            f"{experiment.name}.runs_of: expected an experiment with arms, got {other.name!r}, "
            f"whose runs are those of {other.runs_of!r}"
        )
    own = experiment.model_dump(exclude={"runs_of", *OF_RUNS}, exclude_unset=True)
    return _validated(Experiment, own | other.model_dump(include=OF_RUNS), experiment.name)


def _read(name: str, path: Path) -> Experiment:
    content = _content(path)
    if "name" in content:
        raise ValueError(f"{name}.name: unknown key; an experiment is called like its file, {path}")
    return _validated(Experiment, {"name": name, **content}, name)


def _content(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())}") from None
    if not isinstance(content, dict):
        raise ValueError(f"{path}: expected keys and values, got {content!r}")
    return content


def _validated(kind: Any, values: Any, name: str) -> Any:
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        raise ValueError("\n".join(explain(error, name))) from None
