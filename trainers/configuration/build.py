"""From a plain, resolved configuration to a trainer. The last place that knows the configuration's layout."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from ..environment import EnvironmentFactory, Input, Metric
from ..loggers import MetricsLogger
from ..settings import TrainerSettings
from ..training.progress import Progress
from ..training.trainer import Trainer
from . import checks

Config = Mapping[str, Any]
"""The resolved configuration: dictionaries, lists, strings, numbers."""


def build(node: Config) -> Any:
    """Turn a node with ``_target_`` into a factory: a partial of the target with the node's other entries."""
    arguments = {key: value for key, value in node.items() if key != "_target_"}
    return partial(checks.locate(node["_target_"]), **arguments)


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
        action_history=env.get("action_history", 1),
        symmetries=env.get("symmetries") or {},
        metrics={name: Metric(**(how or {})) for name, how in (env.get("metrics") or {}).items()},
    )


def agent(config: Config) -> Any:
    """A factory of learners; they know the task's symmetry if the algorithm uses it and the environment has one."""
    make = build(config["algorithm"]["agent"])
    symmetry = environment(config).symmetry() if config["algorithm"].get("use_symmetries") else None
    return make if symmetry is None else partial(make, symmetry=symmetry)


def scenarios(config: Config) -> dict[str, EnvironmentFactory]:
    """The environments to evaluate on: the training environment with some arguments of its base replaced."""
    factory = environment(config)
    return {
        name: factory.with_overrides(**(overrides or {}))
        for name, overrides in config["env"]["scenarios"].items()
    }


def loggers(config: Config) -> list[MetricsLogger]:
    """The loggers that are switched on."""
    return [build(node)() for node in _enabled(config["logger"])]


def trainer(config: Config, run_dir: Path, progress: Progress | None = None) -> Trainer:
    """A trainer ready to run in ``run_dir``; nothing is built before the whole configuration is checked."""
    check(config)
    return Trainer(
        settings(config),
        environment(config),
        agent(config),
        build(config["algorithm"]["exploration"]),
        run_dir,
        scenarios=scenarios(config),
        loggers=loggers(config),
        config=config,
        progress=progress,
    )


def check(config: Config) -> None:
    """Find what is wrong with a configuration before any environment is built.

    Raises:
        ValueError: with every problem, one per line: where, what was expected, what came.

    """
    if problems := checks.problems(config):
        raise ValueError("\n".join(problems))


def _enabled(nodes: Config | None) -> list[Config]:
    return [node for node in (nodes or {}).values() if node]
