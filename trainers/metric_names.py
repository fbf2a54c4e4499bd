"""How evaluations name their entries, whose they are, and how their numbers are written."""

from __future__ import annotations

import math

__all__ = ["ABOVE", "ACCEPTED", "CONTROLLER", "EPISODES", "FAULTS", "P99", "decimals", "is_share"]

CONTROLLER = "controller_"
"""Prefix of the entries of the controller alone; without one they are the latest policy's."""
ACCEPTED = "accepted_"
"""Prefix of the entries of what the run hands over, where policies are tested for it."""

EPISODES = "episodes"
"""Entry of the number of episodes of an evaluation."""
FAULTS = "faults"
"""Entry of a robot's faults in the middle of an episode: how many there were."""
P99 = "_p99"
"""Ending of its 99th percentile over the episodes."""
ABOVE = {"budget": "_above_budget", "limit": "_above_limit"}
"""Endings of the share of the episodes in which it is above a bound."""

MOST_DECIMALS = 6
"""What is smaller than the last of them is rounding."""


def is_share(entry: str) -> bool:
    """Return whether an entry of an evaluation is a share of its episodes."""
    return entry.endswith(tuple(ABOVE.values()))


def decimals(*values: float, least: int = 2) -> int:
    """Return how many decimals numbers are written with that stand beside one another.

    At least two digits of the largest are shown: a task may count in metres, or in small rewards.
    """
    size = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    if size < 10**-MOST_DECIMALS:
        return least
    return min(max(least, 1 - math.floor(math.log10(size))), MOST_DECIMALS)
