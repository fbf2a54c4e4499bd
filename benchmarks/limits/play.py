"""Episodes of given commands under the limits of ``configs/safety``, on a robot with a fault."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from rrl.envs import make_config
from rrl.trainers.cli.compose import compose
from rrl.trainers.configuration import build as assembly
from rrl.transforms import ControlNoise, ObservationLatency

from .commands import BATCH

POSITION, LATE = "end_effector_position", "late_position"
FORCE, OUTSIDE, SIZE, CHANGE = "force [N]", "outside the box [mm]", "size", "change"
WATCHED = {"force": (FORCE,), "workspace": (OUTSIDE,), "step": (SIZE, CHANGE)}
"""What each of the limits promises; ``all`` promises all of it."""


@dataclass(frozen=True)
class Case:
    """What is wrong with the robot."""

    delay: int = 0
    """Of the sensors that limits read, in control steps."""
    stiffness: float = 1.0
    """Of the arm, as a share of what is known."""


CASES = {
    "nominal": Case(),
    "delay": Case(delay=2),
    "stiff": Case(stiffness=1.2),
    "soft": Case(stiffness=0.8),
    "delay and stiff": Case(delay=2, stiffness=1.2),
}


def configuration(variant: str, safety: str, case: Case) -> dict[str, Any]:
    """Return what ``rrl train`` would use without a controller."""
    config = compose([f"env=insertion-{variant}", f"safety={safety}", "arm=rl"])
    if config["safety"]["workspace"]:
        config["safety"]["workspace"]["position_key"] = LATE
        config["safety"]["workspace"]["delay"] += case.delay
    return config


def make_env(config: dict[str, Any], case: Case, seed: int) -> EnvBase:
    """Return a batch of environments with nothing but the limits, whose sensors are late.

    Args:
        config: From :func:`configuration`.
        case: What is wrong with the robot.
        seed: Of a round; no two rounds have a slot in common.
    """
    known = make_config(config["env"]["base"]["variant"])
    names = ("joint_stiffness", "cartesian_stiffness")
    changed = {n: tuple(case.stiffness * k for k in getattr(known, n)) for n in names}
    factory = assembly.environment(config)
    # In front of the limits, which stand before everything else.
    late = partial(ObservationLatency, [POSITION], steps=case.delay, out_keys=[LATE])
    watched = partial(ControlNoise, sigma=0.0)  # records what is executed
    factory = replace(factory, sensing=(), disturbances=(watched,), safety=(late, *factory.safety))
    return factory.with_overrides(**changed, seed=seed * BATCH, num_threads=1).make(BATCH)


def play(env: EnvBase, commands: Tensor, safety: dict[str, Any]) -> dict[str, Tensor]:
    """Play commands ``[B, T, 3]`` and return the largest values, ``[B]`` each.

    They are NaN where physics diverged: nobody knows what it would have come to.
    """
    low, high = (torch.tensor(safety["workspace"][side]) for side in ("low", "high"))
    td, last, worst = env.reset(), torch.zeros(len(commands), 3), dict[str, Tensor]()
    known = torch.ones(len(commands), dtype=torch.bool)
    for step in range(commands.shape[1]):
        td = step_mdp(env.step(td.set("action", commands[:, step])))
        position, executed = td[POSITION], td["executed_action"]
        now = {
            FORCE: td["metrics", "contact_force"].squeeze(-1),
            OUTSIDE: 1000 * torch.maximum(low - position, position - high).amax(-1),
            SIZE: executed.abs().amax(-1),
            CHANGE: (executed - last).abs().amax(-1),
        }
        worst = {name: torch.maximum(worst.get(name, value), value) for name, value in now.items()}
        last, known = executed, known & ~td["diverged"].squeeze(-1)
    return {name: value.where(known, torch.nan) for name, value in worst.items()}
