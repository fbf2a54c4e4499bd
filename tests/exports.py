"""A point under a controller, and what a robot gets of it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents import random_policy
from rrl.controllers import PIDController, ProportionalController
from rrl.deploy import Policy
from rrl.trainers.environment import EnvironmentFactory
from rrl.trainers.export.folder import export_policy
from rrl.transforms import FiniteAction, StepLimit
from toy_envs import PointMass

KEYS = ["end_effector_position", "goal"]
OBSERVATION = {"end_effector_position": np.array([0.1, 0.2]), "goal": np.array([0.3, -0.1])}
RATE = 50.0


def point(**changes: Any) -> EnvironmentFactory:
    return EnvironmentFactory(
        **{
            "base": lambda num_envs=1: PointMass([num_envs]),
            "controller": partial(ProportionalController, gain=2.0),
            "inputs": KEYS,
            "max_episode_steps": 20,
            **changes,
        }
    )


def export_with_memory(folder: Path, **changes: Any) -> Path:
    """Export a point with limited steps under a controller with memory; returns ``folder``."""
    own = {
        "controller": partial(PIDController, gain=2.0, integral_gain=0.5, time_step=0.02),
        "inputs": [*KEYS, "previous_action"],
        "residual_scale": 0.5,
        "safety": [partial(StepLimit, change=0.2), partial(FiniteAction, replacement="last")],
        "control_period": 1 / RATE,
        "units": {"goal": "m", "action": "0.1 m"},
    }
    factory = point(**{**own, **changes})
    export_policy(factory, random_policy(factory), folder)
    return folder


def acts(policy: Policy, steps: int = 4, **changes: Any) -> list[np.ndarray]:
    """Commands of some steps in which the robot observes the same."""
    return [policy.act({**OBSERVATION, **changes}).copy() for _ in range(steps)]
