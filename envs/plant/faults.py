"""What a plant can be told to do wrong."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from .client import RemoteRobot

KINDS = ("drop", "delay", "freeze", "nan", "refuse", "die")
"""``drop``: calls are lost; ``delay``: answers come half a second late; ``freeze``: observations
stand still; ``nan``: measured numbers are none; ``refuse``: resets are refused; ``die``: the
process ends at once."""

DELAY = 0.5
"""Seconds by which delayed answers are late."""


class Faults:
    """The faults of a plant, each for some seconds."""

    def __init__(self) -> None:
        self._until: dict[str, float] = {}

    def begin(self, kind: str, seconds: float) -> None:
        """Do ``kind`` wrong for so many seconds from now on.

        Raises:
            ValueError: If there is no such fault.
        """
        if kind not in KINDS:
            raise ValueError(f"kind: expected one of {', '.join(KINDS)}, got {kind!r}")
        if kind == "die":
            os._exit(1)
        self._until[kind] = time.monotonic() + seconds

    def active(self, kind: str) -> bool:
        """Return whether ``kind`` is done wrong now."""
        return time.monotonic() < self._until.get(kind, 0.0)

    def spoil(self, entries: dict[str, Any]) -> dict[str, Any]:
        """Return measured entries with what is wrong with their numbers."""
        if not self.active("nan"):
            return entries
        name = next(n for n, value in entries.items() if value.dtype.kind == "f")
        return {**entries, name: np.full_like(entries[name], np.nan)}


def inject(address: str, kind: str, seconds: float = 1.0) -> None:
    """Tell the plant at ``address`` to do something wrong for some seconds."""
    robot = RemoteRobot(address)
    try:
        robot.ask("fault", 1.0, kind=kind, seconds=seconds)
    finally:
        robot.close()
