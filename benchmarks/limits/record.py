"""Rounds that are kept in a file, so that a measurement can go on, and parts of it be joined."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from .measure import Found, Worst


class Key(NamedTuple):
    """What a round was played with."""

    variant: str
    case: str
    limits: str
    seed: int


class Record:
    """Rounds, one JSON object a line. Files of the same limits may be joined line by line.

    Args:
        path: The file; None keeps nothing.
        safety: The configuration of all limits.

    Raises:
        ValueError: If the file's rounds were played under other limits.
    """

    def __init__(self, path: Path | None, safety: dict[str, Any]) -> None:
        self.path, self.safety = path, safety
        self.rounds: dict[Key, Found] = {}
        if path is not None and path.exists():
            for line in path.read_text().splitlines():
                self._read(json.loads(line))

    def _read(self, entry: dict[str, Any]) -> None:
        if entry["safety"] != self.safety:
            raise ValueError(
                f"{self.path}: expected rounds under {self.safety}, got {entry['safety']}; "
                "name another file, or remove this one"
            )
        found = {kind: Worst(**worst) for kind, worst in entry["found"].items()}
        self.rounds[Key(*entry["key"])] = found

    def add(self, key: Key, found: Found) -> None:
        """Keep a round."""
        self.rounds[key] = found
        if self.path is not None:
            worsts = {kind: asdict(worst) for kind, worst in found.items()}
            entry = {"key": key, "safety": self.safety, "found": worsts}
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with self.path.open("a") as file:
                file.write(json.dumps(entry) + "\n")

    def joined(self) -> dict[tuple[str, str, str], Found]:
        """Return the worst of all rounds by variant, case and limits."""
        joined: dict[tuple[str, str, str], Found] = {}
        for key, found in self.rounds.items():
            total = joined.setdefault(key[:3], {kind: Worst() for kind in found})
            for kind, worst in found.items():
                total[kind].add(worst)
        return joined
