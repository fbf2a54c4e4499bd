"""The store of an experiment's runs.

Layout::

    out/
        runs/
            rotation-0.1-residual-rl-3f2a91c0/   experiment, setting and arm that asked first; the configuration's key
                seeds-0-2/                       one ordinary directory of `rrl train`, three stacked seeds
                    run.json                     {"version", "key", "seeds", "overrides"}, written before it starts
                    log.txt                      what the process said
                    config.yaml                  the resolved configuration
                    metrics.csv                  every metric over environment steps
                    results.json                 the final evaluation: written last, so that it marks a finished run
                    checkpoints/, transitions/   to go on from
        figures/                                 PNG and SVG
        report.html                              report-NAME.html for experiments called by name

A key is a checksum of the resolved configuration without what does not matter to the result (seeds, threads, loggers).
Whoever changes a default gets a new key and new runs; the old ones stay and nothing reads them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..storage.files import write_atomically
from ..storage.run_files import CONFIG_FILE, RESULTS

VERSION = 1
RECORD, LOG = "run.json", "log.txt"


@dataclass(frozen=True)
class StoredRun:
    """A run's place in the store; the directory need not be there yet.

    Attributes:
        path: the run's directory.
        key: of its configuration.
        seeds: trained side by side.
    """

    path: Path
    key: str
    seeds: tuple[int, ...]

    @property
    def name(self) -> str:
        """Readable, unique within the store."""
        return f"{self.path.parent.name}/{self.path.name}"

    @property
    def log(self) -> Path:
        """What its process said."""
        return self.path / LOG

    @property
    def started(self) -> bool:
        """Whether there is something to resume."""
        return (self.path / CONFIG_FILE).is_file()

    @property
    def finished(self) -> bool:
        """Whether the final evaluation of every seed is there."""
        try:
            results = json.loads((self.path / RESULTS).read_text(encoding="utf-8"))
            return bool(results)
        except (OSError, ValueError):
            return False


class Store:
    """The runs below a folder.

    Args:
        out: the folder.
    """

    def __init__(self, out: Path) -> None:
        self.out = out.expanduser().resolve()

    def runs(self, key: str) -> list[StoredRun]:
        """The runs of a configuration, finished or not, in the order of their seeds."""
        found = [_read(path) for path in (self.out / "runs").glob(f"*-{key}/*/{RECORD}")]
        return sorted((run for run in found if run and run.key == key), key=lambda run: run.seeds)

    def place(self, name: str, key: str, seeds: Sequence[int]) -> StoredRun:
        """Where a run that is not there yet will stand."""
        span = f"seeds-{seeds[0]}-{seeds[-1]}" if len(seeds) > 1 else f"seed-{seeds[0]}"
        return StoredRun(self.out / "runs" / name / span, key, tuple(seeds))

    def register(self, run: StoredRun, overrides: Sequence[str]) -> None:
        """Write a run's record, before it starts."""
        run.path.mkdir(parents=True, exist_ok=True)
        record = {
            "version": VERSION,
            "key": run.key,
            "seeds": list(run.seeds),
            "overrides": list(overrides),
        }
        write_atomically(run.path / RECORD, json.dumps(record, indent=1) + "\n")


def recorded_overrides(run_dir: Path) -> list[str]:
    """With which overrides of ``rrl train`` a run was started."""
    return list(json.loads((run_dir / RECORD).read_text(encoding="utf-8"))["overrides"])


def _read(path: Path) -> StoredRun | None:
    record = json.loads(path.read_text(encoding="utf-8"))
    if record["version"] != VERSION:
        raise ValueError(
            f"{path} has version {record['version']}, this code reads {VERSION}: choose another out="
        )
    return StoredRun(path.parent, record["key"], tuple(record["seeds"]))
