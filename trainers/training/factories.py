"""From nodes with ``_target_`` to factories, and those that ``rrl train`` uses by default."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rrl.algorithms import Agent

from ..defaults import default_config
from ..descriptions import named
from ..environment import EnvironmentFactory
from ..settings import TrainerSettings


def locate(path: Any) -> Any:
    """Import ``package.module.name``.

    Raises:
        ValueError: If there is no such thing.
    """
    module, _, name = str(path).rpartition(".")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"_target_: expected package.module.name, got {path!r}: {error}"
        ) from error


def is_target(value: Any) -> bool:
    """Return whether a value of a configuration names what is to be built."""
    return isinstance(value, Mapping) and "_target_" in value


def build(node: Mapping[str, Any]) -> partial[Any]:
    """Turn a node with ``_target_`` into a factory: a partial of the target with its other entries.

    Such nodes among its entries, at any depth, become factories too. YAML has no tuples: in entries
    called ``..._key`` and ``..._keys`` a list stands for a nested key.
    """
    arguments = {key: _argument(key, value) for key, value in node.items() if key != "_target_"}
    return partial(locate(node["_target_"]), **arguments)


def _argument(name: str, value: Any) -> Any:
    if is_target(value):
        return build(value)
    if isinstance(value, Mapping):
        return {key: _argument(key, inner) for key, inner in value.items()}
    if not isinstance(value, list):
        return value
    if name.endswith("_key"):
        return tuple(value)
    return [_argument("_key" if name.endswith("_keys") else "", inner) for inner in value]


def agent_factory(
    algorithm: Mapping[str, Any], environment: EnvironmentFactory
) -> Callable[..., Agent]:
    """Return an algorithm's factory of learners, with the task's symmetry where it uses one.

    Args:
        algorithm: Its configuration.
        environment: The task.
    """
    make = partial(build(algorithm["agent"]), episode_steps=environment.max_episode_steps)
    symmetry = environment.symmetry() if algorithm.get("use_symmetries") else None
    return make if symmetry is None else partial(make, symmetry=symmetry)


def agent_or_default(agent: Any, environment: EnvironmentFactory) -> Callable[..., Agent]:
    """Return what makes a learner: ``agent``, or of None the default algorithm's factory.

    Raises:
        TypeError: If ``agent`` makes nothing.
    """
    if agent is not None:
        if not callable(agent):
            raise TypeError(f"agent: expected what makes a learner, or None, got {agent!r}")
        return agent
    return default_agent(environment)


def default_agent(environment: EnvironmentFactory) -> Callable[..., Agent]:
    """Return the default algorithm's factory of learners."""
    return agent_factory(default_config()["algorithm"], environment)


def settings_of(environment: Any, settings: Any) -> TrainerSettings:
    """Return a trainer's settings, of None the default ones.

    Raises:
        TypeError: If they are something else, or there is no environment's factory before them.
        ValueError: If they are of several runs.
    """
    if not isinstance(environment, EnvironmentFactory):
        got = "TrainerSettings(...)" if isinstance(environment, TrainerSettings) else environment
        raise TypeError(
            f"environment: expected EnvironmentFactory(...), got {got}; it comes before the "
            "settings: Trainer(environment, settings)"
        )
    settings = TrainerSettings() if settings is None else settings
    if not isinstance(settings, TrainerSettings):
        raise TypeError(f"settings: expected TrainerSettings(...) or None, got {settings!r}")
    if (seeds := settings.num_seeds) > 1:
        raise ValueError(
            f"num_seeds: expected 1, for a Trainer trains one run, got {seeds}; make one with each "
            f"seed, or call `rrl train trainer.num_seeds={seeds}`"
        )
    return settings


def in_python(
    settings: TrainerSettings, environment: EnvironmentFactory, agent: Any, exploration: Any
) -> dict[str, Any]:
    """Return the configuration of a run that was not made from YAML, as far as JSON has it."""
    made = {"agent": agent, "exploration": exploration}
    described = {n: make and named(make, modules=False) for n, make in made.items()}
    return {"trainer": settings.model_dump(), **environment.described(), **described}


def default_exploration() -> Callable[..., Any]:
    """Return the default exploration module's factory."""
    return build(default_config()["algorithm"]["exploration"])
