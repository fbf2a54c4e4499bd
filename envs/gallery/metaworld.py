"""Meta-World's tasks with the scripted policies that it ships (Yu et al., 2019)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import packages

OBJECT = (slice(4, 7), slice(22, 25))
"""Where the object's position stands in an observation, now and one step ago [m]."""


def make(task: str) -> Any:
    """Make a task with a goal that is seen, and with a start of its own for every episode.

    Args:
        task: Name without version, such as ``peg-insert-side``.

    Raises:
        ValueError: If there is no such task.
    """
    tasks = packages.metaworld().env_dict.ALL_V3_ENVIRONMENTS_GOAL_OBSERVABLE
    name = f"{task}-v3-goal-observable"
    if name not in tasks:
        known = ", ".join(sorted(n.removesuffix("-v3-goal-observable") for n in tasks))
        raise ValueError(f"task: expected one of {known}, got {task!r}")
    env = tasks[name](seed=0)
    env._freeze_rand_vec = False  # otherwise every episode has the same start
    env.observation_space = env.sawyer_observation_space  # it was made before the goal was shown
    env.seeded_rand_vec = True  # draw from the environment's generator, not from NumPy's
    return env


def seed(env: Any, number: int) -> None:
    """Seed a task, whose ``reset`` ignores its seed."""
    env.seed(number)


class Scripted:
    """The policy that Meta-World ships for a task, as it is or made worse.

    Args:
        task: As for :func:`make`.
        bias: Added to the action ``[4]``, within [-1, 1]: hand's motion (x, y, z), gripper.
        object_offset: By how much it misjudges where the object is (x, y, z) [m].
    """

    def __init__(
        self,
        task: str,
        bias: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        object_offset: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> None:
        policies = packages.metaworld().policies.ENV_POLICY_MAP
        self.policy = policies[f"{task}-v3"]()
        self.bias, self.object_offset = np.array(bias), np.array(object_offset)

    def __call__(self, observation: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the action ``[4]``, within [-1, 1], for an observation ``[39]``."""
        seen = observation.astype(np.float64)
        for entries in OBJECT:
            seen[entries] += self.object_offset
        action = np.clip(self.policy.get_action(seen), -1.0, 1.0)
        return np.clip(action + self.bias, -1.0, 1.0)
