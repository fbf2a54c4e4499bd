"""Frozen episodes of the trainer's chain, and the same ones driven by what was exported of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.transforms import Compose, DoubleToFloat

from rrl.deploy import Policy
from rrl.keys import ACTION, SUCCESS
from rrl.trainers.environment import EnvironmentFactory
from rrl.trainers.evaluation.rollout import rollout
from rrl.trainers.generators import isolated_generators
from rrl.transforms.base import RandomTransform


class Episode(NamedTuple):
    """What was commanded [T, n_act], what the folder would have said to the same entries, and whether it was solved."""

    commands: np.ndarray
    shadow: np.ndarray
    solved: bool


def trainers_episode(
    factory: EnvironmentFactory, policy: Any, exported: Policy, seed: int
) -> Episode:
    """Play with the trainer's chain, and show every observation to the exported policy too."""
    env, shadow = factory.make(1), []
    exported.reset()

    def act(td):
        acted = policy(td)
        shadow.append(exported.act(entries_of(exported, acted)))
        return acted

    with commands_of(env.base_env) as commands:
        solved = played(env, act, seed, factory.max_episode_steps)
    return Episode(np.stack(commands), np.stack(shadow), solved)


def exported_episode(factory: EnvironmentFactory, exported: Policy, seed: int) -> Episode:
    """Play on the bare environment with its faults: all between them comes from the folder."""
    native = {"num_envs": 1} if factory.batching == "native" else {}
    base = factory.base(**native)
    is_double = any(spec.dtype == torch.float64 for spec in base.specs.values(True, True))
    cast = [DoubleToFloat()] if is_double else []  # the trainer's faults are of single precision
    sensing = [make() for make in factory.sensing]
    faults = [make() for make in factory.disturbances]
    faults += [part for part in sensing if isinstance(part, RandomTransform)]  # others are inside
    env = TransformedEnv(base, Compose(*cast, *faults))
    exported.reset()

    def act(td):
        command = torch.from_numpy(exported.act(entries_of(exported, td)))
        spec = env.full_action_spec[ACTION]
        return td.set(ACTION, command.to(spec.dtype).expand(spec.shape))

    with commands_of(env.base_env) as commands:
        solved = played(env, act, seed, factory.max_episode_steps)
    return Episode(np.stack(commands), np.stack(commands), solved)


def entries_of(exported: Policy, td: Any) -> dict[str, np.ndarray]:
    """What a robot would show: every entry without the batch dimensions."""
    entries = exported.contract.entries
    keys = {entry.name: tuple(entry.name.split(".")) for entry in entries}
    return {e.name: td[keys[e.name]].reshape(e.shape).numpy() for e in entries}


def played(env: EnvBase, act: Any, seed: int, max_steps: int) -> bool:
    """Play an episode and return whether it was solved."""
    with isolated_generators(seed):
        *_, (td, _) = rollout(env, act, seed, max_steps)
    env.close()
    return bool(td.get(SUCCESS, torch.zeros(1)).any())


@contextmanager
def commands_of(base: EnvBase) -> Iterator[list[np.ndarray]]:
    """Record what reaches the bare environment."""
    commands, original = [], base._step

    def step(td):
        commands.append(td[ACTION].reshape(-1).numpy().copy())
        return original(td)

    object.__setattr__(base, "_step", step)
    yield commands
