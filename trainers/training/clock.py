"""How far a run is, and its training time, robot time and reset time apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ..loggers import metrics

PARTS = ("training", "robot", "reset")


class Counters(dict[str, int]):
    """Numbers by name, as a part of a run's checkpoints."""

    def state_dict(self) -> dict[str, int]:
        """Return the numbers."""
        return dict(self)

    def load_state_dict(self, state: Mapping[str, int]) -> None:
        """Restore :meth:`state_dict`."""
        self.update(state)


class Clock:
    """Adds up seconds over the rounds and evaluations of a run, and over its restarts.

    Args:
        evaluations: Returns what evaluations have spent since the last time, by part.
    """

    def __init__(self, evaluations: Callable[[], Mapping[str, float]]) -> None:
        self._evaluations = evaluations
        self.seconds = dict.fromkeys(PARTS, 0.0)

    def totals(self, values: metrics.Values) -> dict[str, float]:
        """Take the seconds in ``values``, and return ``values`` with the totals in their place."""
        evaluations = self._evaluations()
        updating = {"training": values.get(metrics.name(metrics.TIME, "update"), 0.0)}
        for part in self.seconds:
            collecting = values.get(metrics.name(metrics.CLOCK, part), 0.0)
            self.seconds[part] += collecting + {**updating, **evaluations}.get(part, 0.0)
        return {**values, **metrics.clock(self.seconds)}

    def state_dict(self) -> dict[str, float]:
        """Return the seconds."""
        return dict(self.seconds)

    def load_state_dict(self, state: Mapping[str, float]) -> None:
        """Restore :meth:`state_dict`."""
        self.seconds.update(state)
