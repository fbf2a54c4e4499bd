"""Names of the TensorDict entries that more than one part of the project reads or writes."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the plant's process reads these names without torch
    from tensordict import NestedKey

ACTION = "action"
"""What the policy says: the residual, in [-1, 1]."""

BASE_ACTION = "base_action"
"""What the controller says, in the environment's action units."""

EXECUTED_ACTION = "executed_action"
"""What the environment was given after superposition, disturbance and clipping."""

PREVIOUS_ACTION = "previous_action"
"""What the policy said in the last steps, oldest first."""

OBSERVATION = "_observation"
"""The features that the actor reads, and critics too unless they read other entries; no entry of an
environment is called so, as many are called "observation"."""

CRITIC_OBSERVATION = "_critic_observation"
"""The features that only the critics read."""

SUCCESS = "success"
"""Whether the task is solved in this state, bool."""

DIVERGED = "diverged"
"""Whether the physics diverged in this step, bool."""

REWARD = "reward"
"""The weighted sum of the reward terms."""

REWARD_TERMS = "reward_terms"
"""Nested entry with one weighted term a name."""

SAFETY = "safety"
"""Nested entry with one flag a limit: whether it changed this step's action, bool."""

METRICS = "metrics"
"""Nested entry with one number a slot and name: what an environment wants reported."""

SO_FAR = "so_far"
"""Nested entry with what each constrained metric has come to in the episode so far."""

OPERATOR_ACTION = "operator_action"
"""What an operator commands, in the environment's action units."""

TAKEN_OVER = "taken_over"
"""Whether an operator has taken over, bool."""

INTERVENTION = "intervention"
"""Nested entry about the last step: ``active`` and ``exceeds``, bool, and ``action``, the residual
that would have given what was commanded."""

INTERVENED = "intervened"
"""Whether this transition's command was an operator's, bool."""

EXCEEDS_AUTHORITY = "exceeds_authority"
"""Whether no residual would have given this transition's command, bool."""


def dotted(key: NestedKey) -> str:
    """Return a key as YAML and contracts write it: the parts of a nested one joined by dots."""
    return key if isinstance(key, str) else ".".join(key)


def leaf(key: NestedKey) -> str:
    """Return the last part of a key."""
    return key if isinstance(key, str) else key[-1]
