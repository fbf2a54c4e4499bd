"""How far a run is, as a part of its checkpoints."""

from __future__ import annotations

__all__ = ["Counters"]


class Counters:
    """Gives a dictionary the interface of a checkpoint's component.

    Args:
        counters: Numbers by name; changed in place.
    """

    def __init__(self, counters: dict[str, int]) -> None:
        self.counters = counters

    def state_dict(self) -> dict[str, int]:
        """Return the numbers."""
        return self.counters

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Take the numbers."""
        self.counters.update(state)
