"""What is wrong with a configuration, found before any environment is built."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from pydantic import ValidationError
from torchrl.data import Composite, Unbounded

from rrl.keys import BASE_ACTION, PREVIOUS_ACTION

from ..environment import EnvironmentFactory, Input
from ..storage.run_files import CONFIG_FILE, seed_directories
from ..storage.versions import missing
from .schema import Schema, explain
from .target_checks import Config, Problems, check_targets, entries


def problems(config: Config, *, training: bool = False, new: bool = False) -> list[str]:
    """Return everything that is wrong, one line each: where, what was expected, what came.

    Args:
        config: Resolved.
        training: Whether it is to be trained, so that this machine needs its device.
        new: Whether it is a run's start, which alone reads the initial weights.
    """
    try:
        Schema.model_validate(config)
    except ValidationError as error:
        return explain(error)
    built: dict[str, Any] = {}
    found = [*check_targets(config, built), *_check_render(config)]
    found += _check_init_from(config) if new else ()
    packages = config["env"].get("packages") or ()
    found += _check_device(config) if training else ()
    found += [f"env.packages: expected installed packages, got {n!r}" for n in missing(packages)]
    return found or list(_check_entries(config, built))


def _check_device(config: Config) -> Problems:
    trainer = config["trainer"]
    if config.get("launcher") == "ray" and trainer["num_seeds"] > 1:
        return  # other machines train
    try:
        device = torch.device(trainer["device"])
        kind = torch.get_device_module(device)
        there = kind.is_available() and (device.index or 0) < kind.device_count()
    except RuntimeError:  # no name of a device
        there = False
    if not there:
        yield f"trainer.device: expected a device of this machine, got {trainer['device']!r}"


def _check_render(config: Config) -> Problems:
    render, scenarios = config["render"], config["env"]["scenarios"]
    if render["scenario"] is not None and render["scenario"] not in scenarios:
        choices = ", ".join(scenarios)
        yield f"render.scenario: expected one of {choices} or null, got {render['scenario']!r}"
    episode, count = render["episode"], config["trainer"]["evaluation"]["final_episodes"]
    if episode != "rescue" and not (type(episode) is int and 0 <= episode < count):
        yield f"render.episode: expected rescue or a number below {count}, got {episode!r}"


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
    sizes = _sensed(entries(env["base"]), built)
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


def _sensed(sizes: dict[str, int] | None, built: Mapping[str, Any]) -> dict[str, int] | None:
    """Return the entries' sizes behind the sensing transforms, which may add entries or numbers.

    None where they are unknown: of an environment that does not tell them, or a transform that
    needs the built one.
    """
    sensing = [part for path, part in built.items() if path.startswith("env.sensing.")]
    if sizes is None or not sensing:
        return sizes
    spec = Composite({name: Unbounded((1, size)) for name, size in sizes.items()}, shape=(1,))
    try:
        for transform in sensing:
            spec = transform.transform_observation_spec(spec)
    except Exception:  # a transform of anybody's; the environment says what is wrong, if it is
        return None
    leaves = spec.items(True, True)
    return {key: leaf.shape[1:].numel() for key, leaf in leaves if isinstance(key, str)}


def _check_symmetries(
    env: Config, inputs: Mapping[str, Input], sizes: dict[str, int] | None
) -> Problems:
    mirrors, known = env.get("symmetries") or {}, sizes or {}
    for name, maps in mirrors.items():
        for key in set(maps) & set(known):
            if len(maps[key]) != known[key]:
                path = f"env.symmetries.{name}.{key}"
                yield f"{path}: expected {known[key]} numbers, got {maps[key]}"
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
