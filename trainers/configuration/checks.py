"""What is wrong with a configuration, found before any environment is built."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from torchrl.data import Bounded

from rrl.keys import BASE_ACTION, PREVIOUS_ACTION

from ..environment import Batching, EnvironmentFactory, Input
from ..metric import Metric
from ..settings import Positive, TrainerSettings
from ..storage.run_files import CONFIG_FILE, seed_directories
from ..storage.versions import missing
from ..training.learner import build, locate

Config = Mapping[str, Any]
Problems = Iterator[str]

PlainName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9._+=-]*$")]
"""A directory or file of that name stays where it is put."""
Target = dict[str, Any]
Targets = dict[str, Target | None] | None
Scale = Annotated[float, Field(ge=0)] | list[Annotated[float, Field(ge=0)]]
Entries = Annotated[dict[str, dict[str, Any] | None], Field(min_length=1)]
Side = Annotated[int, Field(gt=0, le=4096)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Render(_Section):
    enabled: bool
    scenario: str | None
    episode: int | str
    width: Side
    height: Side
    format: Annotated[str, Field(pattern="^(mp4|gif)$")]
    fps: Annotated[float, Field(gt=0)]


class _Env(_Section):
    name: str
    base: Target
    batching: Batching
    max_episode_steps: Positive
    inputs: Entries
    critic_inputs: Entries | None = None
    scenarios: Annotated[dict[PlainName, dict[str, Any] | None], Field(min_length=1)]
    residual_scale: Scale | None = None
    action_history: Positive = 1
    symmetries: dict[str, dict[str, list[int]]] | None = None
    metrics: dict[PlainName, Metric | None] | None = None
    control_period: Annotated[float, Field(gt=0)] | None = None
    units: dict[str, str] | None = None
    sensing: Targets = None
    renderer: Target | None = None
    packages: list[str] | None = None


class _Algorithm(_Section):
    agent: Target
    exploration: Target
    use_symmetries: bool = False


class _InitFrom(_Section):
    run: str | None


class _Operator(_Section):
    intervention: Target | None


class _Root(_Section):
    """The configuration's layout; what a ``_target_`` takes is checked with the target itself."""

    name: PlainName
    arm: str
    residual_scale: Scale
    launcher: Literal["local", "ray"] = "local"
    workers: Positive | None = None
    trainer: TrainerSettings
    render: _Render
    env: _Env
    controller: Target
    disturbance: Targets = None
    safety: Targets = None
    operator: _Operator | None = None
    algorithm: _Algorithm
    init_from: _InitFrom | None = None
    logger: Targets = None

    @model_validator(mode="after")
    def _check(self) -> _Root:
        self.trainer.check_operator(bool(self.operator and self.operator.intervention))
        return self


def problems(config: Config) -> list[str]:
    """Return everything that is wrong, one line each: where, what was expected, what came."""
    try:
        _Root.model_validate(config)
    except ValidationError as error:
        return explain(error)
    built: dict[str, Any] = {}
    found = [*_check_targets(config, built), *_check_render(config), *_check_init_from(config)]
    packages = config["env"].get("packages") or ()
    found += [f"env.packages: expected installed packages, got {n!r}" for n in missing(packages)]
    return found or list(_check_entries(config, built))


def explain(error: ValidationError, prefix: str = "") -> list[str]:
    """Return Pydantic's findings, one line each."""
    return [_line(e, prefix) for e in error.errors()]


def _line(error: Mapping[str, Any], prefix: str) -> str:
    where = ".".join(map(str, ([prefix] if prefix else []) + list(error["loc"])))
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":
        return f"{where}: {message}" if where else message
    if error["type"] == "extra_forbidden":
        return f"{where}: unknown key, got {error['input']!r}"
    if error["type"] == "missing":
        return f"{where}: expected a value, got none"
    return f"{where}: {message[0].lower()}{message[1:]}, got {error['input']!r}"


def _check_targets(config: Config, built: dict[str, Any]) -> Problems:
    """Check every target's arguments; build those that are classes and cheap, into ``built``."""
    env, algorithm = config["env"], config["algorithm"]
    spec = Bounded(-1.0, 1.0, (1, 1), dtype=torch.float32)
    interface = {"inputs": {"observation": 1}, "action_size": 1}
    interface["episode_steps"] = env["max_episode_steps"]
    nodes: list[tuple[str, Target, Config]] = [
        ("controller", config["controller"], {}),
        ("algorithm.agent", algorithm["agent"], interface),
        ("algorithm.exploration", algorithm["exploration"], {"spec": spec}),
    ]
    groups = {"disturbance": config.get("disturbance"), "safety": config.get("safety")}
    groups |= {"operator": config.get("operator")}
    groups |= {"env.sensing": env.get("sensing"), "logger": config.get("logger")}
    for group, members in groups.items():
        nodes += [(f"{group}.{name}", n, {}) for name, n in (members or {}).items() if n]
    for path, node, given in nodes:
        yield from _check_build(path, node, given, built)
    for path, overrides in {
        "env.base": {},
        **{f"env.scenarios.{name}": o or {} for name, o in env["scenarios"].items()},
    }.items():
        yield from _check_environment(path, {**env["base"], **overrides})
    if env.get("renderer"):
        yield from _check_arguments("env.renderer", env["renderer"], 2)


def _check_build(path: str, node: Target, given: Config, built: dict[str, Any]) -> Problems:
    """Check a node's arguments, and their values by building it, unless it is a function.

    A function may read earlier runs or play episodes: only its signature is compared.
    """
    for key, value in node.items():
        if isinstance(value, Mapping) and "_target_" in value:
            yield from _check_arguments(f"{path}.{key}", dict(value), None)
    found = list(_check_arguments(path, node, given))
    yield from found
    if found or not inspect.isclass(locate(node["_target_"])):
        return
    try:
        built[path] = build(node)(**given)
    except ValidationError as error:
        yield from explain(error, path)
    except Exception as error:  # a target may say in any way that it does not like its arguments
        yield f"{path}: {_text(error)}"


def _check_environment(path: str, node: Target) -> Problems:
    """Check an environment's arguments by signature, and by ``check_arguments`` if it has one."""
    found = list(_check_arguments(path, node, {"num_envs": 1}))
    yield from found
    if found:
        return
    try:
        entries(node)
    except Exception as error:
        yield f"{path}: {_text(error)}"


def entries(base: Target) -> dict[str, int] | None:
    """Return the observation entries' sizes, if the environment tells them unbuilt."""
    tell = getattr(locate(base["_target_"]), "check_arguments", None)
    arguments = {key: value for key, value in base.items() if key != "_target_"}
    return None if tell is None else dict(tell(**arguments))


def _check_arguments(path: str, node: Target, given: Config | int | None) -> Problems:
    """Compare a node with its target's signature.

    Args:
        path: Where the node stands.
        node: The node.
        given: Arguments that others supply: by name, the first so many, or None: all that lack.
    """
    target = node.get("_target_")
    if not isinstance(target, str):
        yield f"{path}: expected _target_: package.module.name, got {target!r}"
        return
    try:
        parameters = _parameters(locate(target))
    except (ValueError, TypeError) as error:
        yield f"{path}: {error}"
        return
    names = [n for n, p in parameters.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    supplied = set(names[:given]) if isinstance(given, int) else set(given or ())
    takes = [n for n in names if n not in supplied]
    if not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        for key in sorted(set(node) - set(names) - {"_target_"}):
            yield f"{path}: {target} does not take {key!r}; it takes {', '.join(takes)}"
    for name in takes if given is not None else ():
        if parameters[name].default is inspect.Parameter.empty and name not in node:
            yield f"{path}: {target} needs {name!r}, got {sorted(set(node) - {'_target_'})}"


def _parameters(target: Any) -> dict[str, inspect.Parameter]:
    """Return a target's parameters; an agent's ``**settings`` are fields of its ``Settings``."""
    parameters = dict(inspect.signature(target).parameters)
    settings = getattr(target, "Settings", None)
    if settings is None:
        return parameters
    kept = {n: p for n, p in parameters.items() if p.kind is not p.VAR_KEYWORD}
    keyword = inspect.Parameter.KEYWORD_ONLY
    fields = [*settings.model_fields, "symmetry", "episode_steps", "critic_inputs"]
    return kept | {n: inspect.Parameter(n, keyword, default=None) for n in fields}


def _check_render(config: Config) -> Problems:
    render, scenarios = config["render"], config["env"]["scenarios"]
    if render["scenario"] is not None and render["scenario"] not in scenarios:
        choices = ", ".join(scenarios)
        yield f"render.scenario: expected one of {choices} or null, got {render['scenario']!r}"
    if isinstance(render["episode"], str) and render["episode"] != "rescue":
        yield f"render.episode: expected rescue or a number, got {render['episode']!r}"


def _check_init_from(config: Config) -> Problems:
    run = (config.get("init_from") or {}).get("run")
    path = Path(run or "").expanduser()
    known = (path / CONFIG_FILE).is_file() or seed_directories(path)
    if run is not None and not known:
        yield (
            "init_from.run: expected the directory of a training run, "
            f"got {run!r}: no {CONFIG_FILE} there"
        )


def _check_entries(config: Config, built: dict[str, Any]) -> Problems:
    """Check names and sizes of the observation entries that policy and controller read."""
    env = config["env"]
    groups: dict[str, dict[str, Input]] = {}
    for group in ("inputs", "critic_inputs"):
        for key, entry in (env.get(group) or {}).items():
            path = f"env.{group}.{key}"
            if unknown := sorted(set(entry or {}) - {"loc", "scale", "channels"}):
                yield f"{path}: expected loc and scale, or channels, got {', '.join(unknown)}"
                return
            try:
                groups.setdefault(group, {})[key] = Input(**(entry or {}))
            except ValueError as error:
                yield f"{path}.{error}"
                return
    sizes = entries(env["base"])
    yield from _check_symmetries(env, groups["inputs"], sizes)
    if sizes is None:
        return
    known = ", ".join(sorted(sizes))
    for group, inputs in groups.items():
        for key, entry in inputs.items():
            if key in sizes:
                yield from _check_columns(f"env.{group}.{key}", replace(entry, shape=(sizes[key],)))
            elif key not in (BASE_ACTION, PREVIOUS_ACTION):
                yield f"env.{group}: the environment does not have {key!r}; it has {known}"
    for key in getattr(built.get("controller"), "in_keys", ()):
        if isinstance(key, str) and key not in sizes:
            yield f"controller: reads {key!r}, which the environment does not have; it has {known}"


def _check_symmetries(
    env: Config, inputs: Mapping[str, Input], sizes: dict[str, int] | None
) -> Problems:
    mirrors = env.get("symmetries") or {}
    for name, maps in mirrors.items():
        for key in set(maps) & set(sizes or ()):
            if len(maps[key]) != (sizes or {})[key]:
                path, count = f"env.symmetries.{name}.{key}", (sizes or {})[key]
                yield f"{path}: expected {count} numbers, got {maps[key]}"
                return
    history = env.get("action_history", 1)
    nothing: Any = None
    unbuilt = EnvironmentFactory(
        nothing, nothing, inputs, action_history=history, symmetries=mirrors
    )
    try:
        unbuilt.symmetry()
    except ValueError as error:
        yield f"env.{error}"


def _check_columns(path: str, entry: Input) -> Problems:
    for field in ("loc", "scale"):
        try:
            entry.column(field)
        except (ValueError, TypeError) as error:
            yield f"{path}.{error}"


def _text(error: Exception) -> str:
    """Return an error's text on one line."""
    text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    return " ".join(text.split()) or type(error).__name__
