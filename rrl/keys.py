"""Names of the TensorDict entries that more than one part of the project reads or writes."""

from __future__ import annotations

__all__ = [
    "ACTION",
    "BASE_ACTION",
    "DIVERGED",
    "EXECUTED_ACTION",
    "OBSERVATION",
    "PREVIOUS_ACTION",
    "REWARD",
    "REWARD_TERMS",
    "SAFETY",
    "SUCCESS",
]

ACTION = "action"
"""The policy's action: the residual, in [-1, 1]."""

BASE_ACTION = "base_action"
"""The controller's action, in the environment's action units."""

EXECUTED_ACTION = "executed_action"
"""The action that reached the environment, after superposition, disturbance and clipping."""

PREVIOUS_ACTION = "previous_action"
"""The policy's actions of the last steps, oldest first."""

OBSERVATION = "observation"
"""The concatenated vector that actor and critic read."""

SUCCESS = "success"
"""Whether the task is solved in this state, bool."""

DIVERGED = "diverged"
"""Whether the physics diverged in this step, bool."""

REWARD = "reward"
"""The weighted sum of the reward terms."""

REWARD_TERMS = "reward_terms"
"""Nested entry with one weighted reward term for each name."""

SAFETY = "safety"
"""Nested entry with one flag for each safety limit: whether it changed this step's action, bool."""
