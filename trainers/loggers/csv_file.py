"""A tidy CSV file."""

from __future__ import annotations

import contextlib
import csv
import io
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TextIO

from ..storage.files import write_atomically
from ..storage.run_files import METRICS
from .base import MetricsLogger
from .metrics import FINAL, STEP_AXIS, Values

Row = tuple[int, str, float]


class CSVLogger(MetricsLogger):
    """``metrics.csv`` with columns ``env_steps, metric, value``: the run's own record."""

    def start(self, run_dir: Path, config: Mapping[str, Any], env_steps: int) -> None:
        """Open the file; a resumed run keeps the rows up to ``env_steps``.

        The final evaluation comes after the last checkpoint, so it is made again.
        """
        path = run_dir / METRICS
        rows = [row for row in _rows_of(path) if _is_kept(row, env_steps)] if env_steps else []
        kept = io.StringIO()
        csv.writer(kept).writerows([(STEP_AXIS, "metric", "value"), *rows])
        write_atomically(path, kept.getvalue())
        self.file: TextIO = path.open("a", newline="", encoding="utf-8")
        self.writer = csv.writer(self.file)

    def log(self, values: Values, env_steps: int) -> None:
        """Append one row per metric and pass them to the operating system at once."""
        for metric, value in values.items():
            self.writer.writerow([env_steps, metric, repr(float(value))])
        self.file.flush()

    def flush(self) -> None:
        """Fsync the file."""
        os.fsync(self.file.fileno())

    def finish(self) -> None:
        """Close the file."""
        self.file.close()


def read_metrics(run_dir: Path) -> dict[str, list[tuple[int, float]]]:
    """Read a run's ``metrics.csv``: for every metric ``(env_steps, value)`` in order.

    Raises:
        FileNotFoundError: If there is none.
    """
    path = run_dir / METRICS
    if not path.is_file():
        raise FileNotFoundError(f"{run_dir}: expected {METRICS}, got none: is the CSV logger on?")
    out: dict[str, list[tuple[int, float]]] = {}
    for env_steps, metric, value in _rows_of(path):
        out.setdefault(metric, []).append((env_steps, value))
    return out


def _is_kept(row: Row, env_steps: int) -> bool:
    return row[0] <= env_steps and not row[1].startswith(f"{FINAL}/")


def _rows_of(path: Path) -> Iterator[Row]:
    text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    return whole_rows(text)


def whole_rows(text: str) -> Iterator[Row]:
    """Yield the rows that can be read: not the header, nor one that a crash has torn."""
    for line in text.split("\n")[:-1]:
        env_steps, _, rest = line.partition(",")
        metric, _, value = rest.rpartition(",")
        if metric.startswith('"'):
            metric = metric[1:-1].replace('""', '"')
        with contextlib.suppress(ValueError):
            yield int(env_steps), metric, float(value)
