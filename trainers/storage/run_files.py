"""Names of the files in a run's directory."""

from __future__ import annotations

from pathlib import Path

CONFIG_FILE = "config.yaml"
CHECKPOINTS = "checkpoints"
VIDEOS = "videos"
METRICS = "metrics.csv"
RESULTS = "results.json"
VERSIONS = "versions.json"
DERIVED = "derived.yaml"
REPORT = "report.html"
LOG = "log.txt"
EXPORT = "export"

PLAIN_NAME = r"[A-Za-z0-9_][A-Za-z0-9._+=-]*"
"""A file or directory of that name stays where it is put."""


def seed_directories(run_dir: Path) -> list[Path]:
    """Return the runs of a group, ``seed-<n>`` below its directory, by seed."""
    found = [path.parent for path in run_dir.glob(f"seed-*/{CONFIG_FILE}")]
    return sorted(found, key=lambda path: (len(path.name), path.name))
