"""Where a run's time goes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["Stopwatch"]


class Stopwatch:
    """Adds up the seconds spent in named sections since the last :meth:`lap`."""

    def __init__(self) -> None:
        self._sections: dict[str, float] = {}

    @contextmanager
    def __call__(self, section: str) -> Iterator[None]:
        """Time the body of a ``with`` statement."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(section, time.perf_counter() - start)

    def add(self, section: str, seconds: float) -> None:
        """Count seconds that were measured elsewhere."""
        if seconds:
            self._sections[section] = self._sections.get(section, 0.0) + seconds

    def lap(self) -> dict[str, float]:
        """Return the seconds by section and start anew."""
        sections, self._sections = self._sections, {}
        return sections
