"""A tidy CSV file."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from ..storage.run_files import METRICS
from .base import MetricsLogger
from .metrics import STEP_AXIS, Values


class CSVLogger(MetricsLogger):
    """``metrics.csv`` with columns ``env_steps, seed, metric, value``: the run's own record, read by the plots."""

    FILE = METRICS

    def start(
        self, run_dir: Path, config: Mapping[str, Any], seeds: Sequence[int], env_steps: int
    ) -> None:
        """Open the file; a resumed run keeps the rows up to ``env_steps``."""
        path = run_dir / self.FILE
        self.seeds = seeds
        rows = _rows_until(path, env_steps) if env_steps else []
        partial = path.with_suffix(".partial")
        with partial.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([STEP_AXIS, "seed", "metric", "value"])
            writer.writerows(rows)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        self.file: TextIO = path.open("a", newline="")
        self.writer = csv.writer(self.file)

    def log(self, values: Values, env_steps: int) -> None:
        """Append one row per seed and metric, and hand them to the operating system at once."""
        for metric, per_seed in values.items():
            for seed, value in zip(self.seeds, per_seed, strict=True):
                self.writer.writerow([env_steps, seed, metric, repr(float(value))])
        self.file.flush()

    def flush(self) -> None:
        """Have the disk hold all rows."""
        os.fsync(self.file.fileno())

    def finish(self) -> None:
        """Close the file."""
        self.file.close()


def read_metrics(run_dir: Path) -> dict[str, dict[int, list[tuple[int, float]]]]:
    """Read what is written of a run's ``metrics.csv``: metric, then seed, then ``(env_steps, value)`` in order."""
    out: dict[str, dict[int, list[tuple[int, float]]]] = {}
    for env_steps, seed, metric, value in _whole_rows(run_dir / CSVLogger.FILE):
        out.setdefault(metric, {}).setdefault(int(seed), []).append((int(env_steps), float(value)))
    return out


def _rows_until(path: Path, env_steps: int) -> list[list[str]]:
    """Whole rows up to ``env_steps``."""
    return [row for row in _whole_rows(path) if int(row[0]) <= env_steps] if path.exists() else []


def _whole_rows(path: Path) -> list[list[str]]:
    """All rows but the header, and one torn by a crash or not yet written to its end."""
    text = path.read_text()
    rows = csv.reader(text[: text.rfind("\n") + 1].splitlines())
    return [row for row in rows if len(row) == 4 and row[0].isdigit()]
