"""Rounds of episodes under one limit, what they come to, and what may not be exceeded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torchrl.envs import EnvBase

from rrl.trainers.cli.compose import compose

from .commands import SCRIPTED, CrossEntropy
from .play import CHANGE, FORCE, OUTSIDE, SIZE, WATCHED, Case, configuration, make_env, play

TOLERANCE = 1e-5
"""Of commands, which are of single precision."""
GENERATIONS = 20
"""Of an adversary, of which a round has one: it starts anew with every round."""


@dataclass
class Worst:
    """The largest values measured, and in how many episodes; NaN once something is unknown."""

    episodes: int = 0
    values: dict[str, float] = field(default_factory=dict)

    def take(self, values: dict[str, Tensor]) -> None:
        """Take in what a batch of episodes came to, ``[B]`` each."""
        largest = {name: float(value.max()) for name, value in values.items()}
        self.add(Worst(len(next(iter(values.values()))), largest))

    def add(self, other: Worst) -> None:
        """Take in what other episodes came to."""
        self.episodes += other.episodes
        for name, value in other.values.items():
            self.values[name] = float(np.maximum(self.values.get(name, -np.inf), value))


Found = dict[str, Worst]
"""The worst of every kind of commands."""


def measure(
    variant: str, name: str, case: Case, seed: int, generations: int = GENERATIONS
) -> Found:
    """Play a round: a batch of every kind of scripted commands, and an adversary.

    Args:
        variant: Of the insertion task.
        name: Of a limit, or ``all``.
        case: What is wrong with the robot.
        seed: Of the round.
        generations: Batches of the adversary.
    """
    config, promised = configuration(variant, name, case), promises(variant)
    generator = torch.Generator().manual_seed(seed)
    env = make_env(config, case, seed)
    found = {kind: Worst() for kind in (*SCRIPTED, "adversary")}
    for kind, draw in SCRIPTED.items():
        found[kind].take(play(env, draw(generator), promised))
    harm = OUTSIDE if name == "workspace" else FORCE
    for values in adversary(env, generations, harm, promised, generator):
        found["adversary"].take(values)
    env.close()
    return found


def adversary(
    env: EnvBase, generations: int, harm: str, safety: dict[str, Any], generator: torch.Generator
) -> Iterator[dict[str, Tensor]]:
    """Play commands that move to what does most ``harm``."""
    optimizer = CrossEntropy(generator)
    for _ in range(generations):
        values = play(env, optimizer.draw(), safety)
        optimizer.learn(values[harm])
        yield values


def promises(variant: str) -> dict[str, Any]:
    """Return the configuration of all limits."""
    return compose([f"env=insertion-{variant}", "safety=all", "arm=rl"])["safety"]


def bounds(variant: str) -> dict[str, float]:
    """Return what no value may exceed."""
    safety = promises(variant)
    return {
        FORCE: safety["force"]["limit"],
        OUTSIDE: 0.0,
        SIZE: safety["step"]["size"] + TOLERANCE,
        CHANGE: safety["step"]["change"] + TOLERANCE,
    }


def promised_by(name: str) -> list[str]:
    """Return the values that a limit promises something of."""
    return [v for kind, values in WATCHED.items() if name in (kind, "all") for v in values]


def excesses(variant: str, name: str, found: Found) -> list[str]:
    """Return what is not within a limit that ``name`` promises, in words; NaN is not."""
    limits = bounds(variant)
    return [
        f"{variant}, {name}, {kind}: {value} {worst.values[value]:.4g} > {limits[value]:.4g}"
        for kind, worst in found.items()
        for value in promised_by(name)
        if not worst.values[value] <= limits[value]
    ]
