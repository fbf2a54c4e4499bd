"""From a plain, resolved configuration to a trainer. The last place that knows its layout."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..environment import EnvironmentFactory, Input
from ..loggers import MetricsLogger
from ..metric import Metric
from ..settings import TrainerSettings
from ..storage.checkpoints import saved_note
from ..training.factories import agent_factory, build
from ..training.progress import Progress
from ..training.trainer import Trainer
from . import checks

__all__ = [
    "agent",
    "build",
    "check",
    "control_period",
    "environment",
    "loggers",
    "scenarios",
    "settings",
    "trainer",
]

Config = Mapping[str, Any]
"""The resolved configuration: dictionaries, lists, strings, numbers."""


def settings(config: Config) -> TrainerSettings:
    """Return the trainer's settings.

    Raises:
        pydantic.ValidationError: If there are unknown keys, wrong types, values out of range or
            contradictions.
    """
    return TrainerSettings.model_validate(config["trainer"])


def environment(config: Config) -> EnvironmentFactory:
    """Return the training environment: base, safety, disturbance, sensing, controller, inputs."""
    env = config["env"]
    return EnvironmentFactory(
        base=build(env["base"]),
        controller=build(config["controller"]),
        inputs=_inputs(env["inputs"]),
        critic_inputs=None if env.get("critic_inputs") is None else _inputs(env["critic_inputs"]),
        disturbances=[build(node) for node in _enabled(config.get("disturbance"))],
        sensing=[build(node) for node in _enabled(env.get("sensing"))],
        safety=[build(node) for node in _enabled(config.get("safety"))],
        residual_scale=config["residual_scale"],
        batching=env["batching"],
        max_episode_steps=env["max_episode_steps"],
        action_history=env.get("action_history", 1),
        symmetries=env.get("symmetries") or {},
        metrics={name: Metric(**(how or {})) for name, how in (env.get("metrics") or {}).items()},
        control_period=env.get("control_period"),
        judged=env.get("judged", False),
        intervention=next(map(build, _enabled(config.get("operator"))), None),
        units=env.get("units") or {},
    )


def control_period(config: Config) -> float | None:
    """Return at which period the policy is asked, in seconds; None: as the environment says."""
    trainer, period = config["trainer"], config["env"].get("control_period")
    driven = trainer["realtime"]["period"] if trainer["collection"] == "realtime" else None
    return driven or period


def agent(config: Config) -> Any:
    """Return a factory of learners, which know the task's symmetry if the algorithm uses it."""
    return agent_factory(config["algorithm"], environment(config))


def scenarios(config: Config) -> dict[str, EnvironmentFactory]:
    """Return the environments to evaluate on: the training one with some arguments replaced."""
    factory, base = environment(config), config["env"]["base"]
    return {
        name: replace(factory, base=build({**base, **(overrides or {})}))
        for name, overrides in config["env"]["scenarios"].items()
    }


def loggers(config: Config) -> list[MetricsLogger]:
    """Return the loggers that are switched on."""
    return [build(node)() for node in _enabled(config.get("logger"))]


def trainer(
    config: Config, run_dir: Path, progress: Progress | None = None, *, checked: bool = False
) -> Trainer:
    """Return a trainer ready to run in ``run_dir``.

    Args:
        config: Resolved.
        run_dir: Where the run writes.
        progress: Shows how far the run is.
        checked: Whether the whole configuration was checked; else it is, first of all.

    Raises:
        ValueError: See :func:`check`.
    """
    if not checked:
        check(config, training=True, new=not saved_note(run_dir))
    return Trainer(
        environment(config),
        settings(config),
        agent(config),
        build(config["algorithm"]["exploration"]),
        run_dir,
        scenarios=scenarios(config),
        loggers=loggers(config),
        config=config,
        progress=progress,
    )


def check(config: Config, *, training: bool = False, new: bool = False) -> None:
    """Find what is wrong with a configuration, without environment, robot or file.

    Controller, learner, exploration, transforms, operator and loggers are made, and thrown away;
    see :func:`.target_checks.check_targets`.

    Args:
        config: Resolved.
        training: Whether it is to be trained, so that this machine needs its device.
        new: Whether it is a run's start, which alone reads the initial weights.

    Raises:
        ValueError: With every problem, one per line: where, what was expected, what came.
    """
    if problems := checks.problems(config, training=training, new=new):
        raise ValueError("\n".join(problems))


def _inputs(entries: Config) -> dict[str, Input]:
    return {key: Input(**(entry or {})) for key, entry in entries.items()}


def _enabled(nodes: Config | None) -> list[Config]:
    return [node for node in (nodes or {}).values() if node]
