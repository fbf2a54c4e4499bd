"""What is wrong with a configuration, found before any environment is built."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from torchrl.data import Bounded

from rrl.keys import BASE_ACTION, PREVIOUS_ACTION

from ..environment import Batching, EnvironmentFactory, Input
from ..settings import Positive, TrainerSettings
from ..storage.run_files import CONFIG_FILE

Config = Mapping[str, Any]
Problems = Iterator[str]

PlainName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9._+=-]*$")]
"""A directory or file of that name stays where it is put."""
Target = dict[str, Any]
Targets = dict[str, Target | None] | None
Scale = Annotated[float, Field(ge=0)] | list[Annotated[float, Field(ge=0)]]
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
    inputs: Annotated[dict[str, dict[str, Any] | None], Field(min_length=1)]
    scenarios: Annotated[dict[PlainName, dict[str, Any] | None], Field(min_length=1)]
    residual_scale: Scale = 1.0
    action_history: Positive = 1
    symmetries: dict[str, dict[str, list[int]]] | None = None
    sensing: Targets = None
    renderer: Target | None = None


class _Algorithm(_Section):
    agent: Target
    exploration: Target
    use_symmetries: bool = False


class _InitFrom(_Section):
    run: str | None


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
    algorithm: _Algorithm
    init_from: _InitFrom | None = None
    logger: Targets = None


def problems(config: Config) -> list[str]:
    """Everything that is wrong, one line each: where, what was expected, what came."""
    try:
        _Root.model_validate(config)
    except ValidationError as error:
        return explain(error)
    return [*_check_targets(config), *_check_render(config), *_check_init_from(config)] or list(
        _check_entries(config)
    )


def explain(error: ValidationError, prefix: str = "") -> list[str]:
    """Pydantic's findings, one line each."""
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


def _check_targets(config: Config) -> Problems:
    """Build what is cheap: controller, transforms, loggers, a small agent; let environments check their arguments."""
    env, seeds = config["env"], {"num_seeds": 1, "seed": 0}
    agent = {"input_sizes": {"observation": 1}, "action_size": 1, **seeds}
    spec = Bounded(-1.0, 1.0, (1, 1), dtype=torch.float32)
    yield from _check_build("controller", config["controller"])
    yield from _check_build("algorithm.agent", config["algorithm"]["agent"], **agent)
    yield from _check_build(
        "algorithm.exploration", config["algorithm"]["exploration"], spec=spec, num_slots=1, seed=0
    )
    groups = {"disturbance": config.get("disturbance"), "safety": config.get("safety")}
    groups |= {"env.sensing": env.get("sensing"), "logger": config.get("logger")}
    for group, nodes in groups.items():
        for name, node in (nodes or {}).items():
            if node:
                yield from _check_build(f"{group}.{name}", node)
    yield from _check_environment("env.base", env["base"], {})
    for name, overrides in env["scenarios"].items():
        yield from _check_environment(f"env.scenarios.{name}", env["base"], overrides or {})
    if env.get("renderer"):
        yield from _check_arguments("env.renderer", env["renderer"], 2)


def _check_build(path: str, node: Target, **given: Any) -> Problems:
    """Build a node's target with ``given`` arguments, and report what it says."""
    found = list(_check_arguments(path, node, given))
    yield from found
    if found:
        return
    arguments = {key: value for key, value in node.items() if key != "_target_"}
    try:
        locate(node["_target_"])(**arguments, **given)
    except Exception as error:  # a target may say in any way that it does not like its arguments
        yield f"{path}: {_text(error)}"


def _check_environment(path: str, node: Target, overrides: Config) -> Problems:
    """Check an environment's arguments by its signature, and by its own ``check_arguments`` where it has one."""
    node = {**node, **overrides}
    found = list(_check_arguments(path, node, {"num_envs": 1, "seed": 0}))
    yield from found
    if found:
        return
    try:
        entries(node)
    except Exception as error:
        yield f"{path}: {_text(error)}"


def entries(base: Target) -> dict[str, int] | None:
    """Sizes of the observation entries, from an environment that can tell them without being built; None otherwise."""
    tell = getattr(locate(base["_target_"]), "check_arguments", None)
    arguments = {key: value for key, value in base.items() if key != "_target_"}
    return None if tell is None else dict(tell(**arguments))


def _check_arguments(path: str, node: Target, given: Config | int) -> Problems:
    """Compare a node with its target's signature; ``given`` are arguments that others supply, by name or in number."""
    if not isinstance(node.get("_target_"), str):
        yield f"{path}: expected _target_: package.module.name, got {node.get('_target_')!r}"
        return
    try:
        parameters = inspect.signature(locate(node["_target_"])).parameters
    except (ValueError, TypeError) as error:
        yield f"{path}: {error}"
        return
    names = [n for n, p in parameters.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    supplied = set(names[:given]) if isinstance(given, int) else set(given)
    takes = [n for n in names if n not in supplied]
    if not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        for key in sorted(set(node) - set(names) - {"_target_"}):
            yield f"{path}: {node['_target_']} does not take {key!r}; it takes {', '.join(takes)}"
    for name in takes:
        if parameters[name].default is inspect.Parameter.empty and name not in node:
            yield f"{path}: {node['_target_']} needs {name!r}, got {sorted(set(node) - {'_target_'})}"


def _check_render(config: Config) -> Problems:
    render, scenarios = config["render"], config["env"]["scenarios"]
    if render["scenario"] is not None and render["scenario"] not in scenarios:
        yield f"render.scenario: expected one of {', '.join(scenarios)} or null, got {render['scenario']!r}"
    if isinstance(render["episode"], str) and render["episode"] != "rescue":
        yield f"render.episode: expected rescue or a number, got {render['episode']!r}"


def _check_init_from(config: Config) -> Problems:
    run = (config.get("init_from") or {}).get("run")
    if run is not None and not (Path(run).expanduser() / CONFIG_FILE).is_file():
        yield f"init_from.run: expected the directory of a training run, got {run!r}: no {CONFIG_FILE} there"


def _check_entries(config: Config) -> Problems:
    """Names and sizes of the observation entries that policy and controller read."""
    for key, entry in config["env"]["inputs"].items():
        unknown = sorted(set(entry or {}) - {"loc", "scale"})
        if unknown:
            yield f"env.inputs.{key}: expected loc and scale, got {', '.join(unknown)}"
            return
    sizes = entries(config["env"]["base"])
    yield from _check_symmetries(config["env"], sizes)
    if sizes is None:
        return
    known = ", ".join(sorted(sizes))
    for key, entry in config["env"]["inputs"].items():
        if key in sizes:
            yield from _check_columns(f"env.inputs.{key}", Input(**(entry or {})), sizes[key])
        elif key not in (BASE_ACTION, PREVIOUS_ACTION):
            yield f"env.inputs: the environment does not have {key!r}; it has {known}"
    controller = locate(config["controller"]["_target_"])(
        **{key: value for key, value in config["controller"].items() if key != "_target_"}
    )
    for key in controller.in_keys:
        if isinstance(key, str) and key not in sizes:
            yield f"controller: reads {key!r}, which the environment does not have; it has {known}"


def _check_symmetries(env: Config, sizes: dict[str, int] | None) -> Problems:
    inputs = {key: Input(**(entry or {})) for key, entry in env["inputs"].items()}
    mirrors = env.get("symmetries") or {}
    for name, maps in mirrors.items():
        for key in set(maps) & set(sizes or ()):
            if len(maps[key]) != (sizes or {})[key]:
                yield f"env.symmetries.{name}.{key}: expected {(sizes or {})[key]} numbers, got {maps[key]}"
                return
    unbuilt = EnvironmentFactory(
        None, None, inputs, action_history=env.get("action_history", 1), symmetries=mirrors
    )  # type: ignore[arg-type]
    try:
        unbuilt.symmetry()
    except ValueError as error:
        yield f"env.{error}"


def _check_columns(path: str, entry: Input, size: int) -> Problems:
    for name in ("loc", "scale"):
        try:
            column = entry.column(path, getattr(entry, name), size)
        except (ValueError, TypeError) as error:
            yield f"{path}.{name}: {error}"
            continue
        if not column.isfinite().all():
            yield f"{path}.{name}: expected finite numbers, got {getattr(entry, name)!r}"


def locate(path: str) -> Any:
    """Import ``package.module.name``.

    Raises:
        ValueError: if there is no such thing.

    """
    module, _, name = path.rpartition(".")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"_target_ {path!r} cannot be imported: {error}") from error


def _text(error: Exception) -> str:
    """An error's first paragraph."""
    text = str(error.args[0]) if isinstance(error, KeyError) and error.args else str(error)
    return " ".join(text.split()) or type(error).__name__
