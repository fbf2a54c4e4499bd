"""What nobody should have to tune: numbers derived from the environment and from first episodes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

VALUE_SPREAD = 10.0
"""How far apart, roughly, the critics' values of good and bad states shall lie."""
NORMAL = 1.2533
"""Standard deviation over mean absolute deviation of normally distributed numbers."""
LEAST_SHARE = 0.1
"""Rewards that hardly differ count as if they differed by this share of their size."""
WARMUP_EPISODES = 5
WARMUP_STEPS = 300
WARMUP_SHARE = 0.1
"""The warm-up lasts for so many episodes and steps, but not longer than this share of a run."""


def discount(episode_steps: int) -> float:
    """Return a discount that looks two thirds of an episode ahead: 0.97 for 50 steps.

    Args:
        episode_steps: Steps of an episode.
    """
    return min(max(1.0 - 1.5 / episode_steps, 0.9), 0.995)


def warmup_length(episode_steps: int, total_steps: int, multiple: int) -> int:
    """Return for how many steps the controller acts alone before anything is learned.

    Args:
        episode_steps: Steps of an episode.
        total_steps: Steps of the run.
        multiple: What the result is a multiple of.
    """
    wanted = max(WARMUP_STEPS, WARMUP_EPISODES * episode_steps)
    rounds = int(min(wanted, WARMUP_SHARE * total_steps)) // multiple
    return min(max(rounds, 1) * multiple, max(total_steps - multiple, 0))


def penalty_updates(episode_steps: int) -> int:
    """Return after how many updates the residual's price is halved: two a step of 10 episodes.

    Args:
        episode_steps: Steps of an episode.
    """
    return 20 * episode_steps


def reward_factor(rewards: Tensor, gamma: float, n_step: int = 1) -> float | None:
    """Return the factor that gives values a spread of about :data:`VALUE_SPREAD`.

    Multiplying all rewards by a number divides the result by it, so that learning is the same.

    Args:
        rewards: Rewards ``[n]``.
        gamma: Discount.
        n_step: Of how many steps each is the sum.

    Returns:
        The factor; None if all rewards are 0, which says nothing of their size.
    """
    rewards = rewards.double() / sum(gamma**i for i in range(n_step))
    size = rewards.square().mean().sqrt()
    # Not the standard deviation: whether one episode in five succeeds would double it.
    deviation = NORMAL * (rewards - rewards.median()).abs().mean()
    spread = torch.maximum(deviation, LEAST_SHARE * size)
    if not spread > 0:
        return None
    return float(VALUE_SPREAD * (1 - gamma) / spread)


DERIVATIONS: Mapping[str, Callable[[int], Any]] = {
    "gamma": discount,
    "penalty_updates": penalty_updates,
}
"""From the steps of an episode to a setting."""


def derived(settings: Any, name: str, episode_steps: int | None) -> Any:
    """Return a setting, derived from the steps of an episode if it is None.

    Raises:
        ValueError: If there is nothing to derive it from.
    """
    value = getattr(settings, name)
    if value is not None:
        return value
    if episode_steps is None:
        raise ValueError(f"{name}: expected a number, or episode_steps to derive it from")
    return DERIVATIONS[name](episode_steps)
