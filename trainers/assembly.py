"""From a plain, resolved configuration to a trainer. The last place that knows the configuration's layout."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from .config import TrainerSettings
from .environment import EnvironmentFactory, Input
from .loggers import MetricsLogger
from .progress import Progress
from .trainer import Trainer

Config = Mapping[str, Any]
"""The resolved configuration: dictionaries, lists, strings, numbers."""


def build(node: Config) -> Any:
    """Turn a node with ``_target_`` into a factory: a partial of the target with the node's other entries."""
    arguments = {key: value for key, value in node.items() if key != "_target_"}
    return partial(_locate(node["_target_"]), **arguments)


def settings(config: Config) -> TrainerSettings:
    """The trainer's settings.

    Raises:
        pydantic.ValidationError: unknown keys, wrong types, values out of range, contradictions.

    """
    return TrainerSettings.model_validate(config["trainer"])


def environment(config: Config) -> EnvironmentFactory:
    """The training environment: base, safety, disturbance, sensing, controller, inputs."""
    env = config["env"]
    return EnvironmentFactory(
        base=build(env["base"]),
        controller=build(config["controller"]),
        inputs={key: Input(**(entry or {})) for key, entry in env["inputs"].items()},
        disturbances=[build(node) for node in _enabled(config["disturbance"])],
        sensing=[build(node) for node in _enabled(env.get("sensing"))],
        safety=[build(node) for node in _enabled(config.get("safety"))],
        residual_scale=config["residual_scale"],
        batching=env["batching"],
        max_episode_steps=env["max_episode_steps"],
    )


def scenarios(config: Config) -> dict[str, EnvironmentFactory]:
    """The environments to evaluate on: the training environment with some arguments of its base replaced."""
    factory = environment(config)
    return {name: factory.with_overrides(**(overrides or {})) for name, overrides in config["env"]["scenarios"].items()}


def loggers(config: Config) -> list[MetricsLogger]:
    """The loggers that are switched on."""
    return [build(node)() for node in _enabled(config["logger"])]


def trainer(config: Config, run_dir: Path, progress: Progress | None = None) -> Trainer:
    """A trainer ready to run in ``run_dir``; nothing is built before the whole configuration is checked."""
    check(config)
    return Trainer(
        settings(config),
        environment(config),
        build(config["algorithm"]["agent"]),
        build(config["algorithm"]["exploration"]),
        run_dir,
        scenarios=scenarios(config),
        loggers=loggers(config),
        config=config,
        progress=progress,
    )


def check(config: Config) -> None:
    """Find what is wrong with a configuration before anything is built.

    Raises:
        ValueError: with every problem found in a ``_target_`` node, one per line: where, what came, what is known.
        pydantic.ValidationError: problems of the trainer's settings.

    """
    settings(config)
    problems = [p for path, node in _targets(config, "") for p in _check_target(path, node)]
    if not config["env"]["scenarios"]:
        problems.append("env.scenarios: expected at least one scenario to evaluate on, got none")
    if not config["env"]["inputs"]:
        problems.append("env.inputs: expected at least one observation entry for the policy, got none")
    if problems:
        raise ValueError("\n".join(problems))


def _enabled(nodes: Config | None) -> list[Config]:
    return [node for node in (nodes or {}).values() if node]


def _targets(node: Any, path: str) -> Iterator[tuple[str, Config]]:
    if isinstance(node, Mapping):
        if "_target_" in node:
            yield path, node
        for key, child in node.items():
            yield from _targets(child, f"{path}.{key}" if path else str(key))


def _check_target(path: str, node: Config) -> list[str]:
    try:
        target = _locate(node["_target_"])
    except ValueError as error:
        return [f"{path}: {error}"]
    parameters = inspect.signature(target).parameters
    if any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        return []
    unknown = sorted(set(node) - set(parameters) - {"_target_"})
    return [f"{path}: {node['_target_']} does not take {key!r}; it takes {sorted(parameters)}" for key in unknown]


def _locate(path: str) -> Any:
    """Import ``package.module.name``."""
    module, _, name = path.rpartition(".")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"_target_ {path!r} cannot be imported: {error}") from error
