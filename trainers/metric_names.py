"""How evaluations name their entries: whose they are, and what is derived from a quantity."""

from __future__ import annotations

__all__ = ["ABOVE", "ACCEPTED", "CONTROLLER", "EPISODES", "FAULTS", "P99", "is_share"]

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


def is_share(entry: str) -> bool:
    """Return whether an entry of an evaluation is a share of its episodes."""
    return entry.endswith(tuple(ABOVE.values()))
