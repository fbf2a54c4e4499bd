"""Which software a run was made with."""

from __future__ import annotations

import json
from importlib import metadata
from pathlib import Path
from platform import platform, python_version

from .files import write_atomically
from .run_files import VERSIONS

PACKAGES = ("rrl", "torch", "torchrl", "tensordict", "mujoco", "dm-control", "gymnasium", "numpy")


def versions() -> dict[str, str]:
    """Versions of Python, of the platform and of the packages that decide what a run computes."""
    found = {"python": python_version(), "platform": platform()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def write_versions(run_dir: Path) -> None:
    """Write ``versions.json``; a resumed run keeps the newest."""
    write_atomically(run_dir / VERSIONS, json.dumps(versions(), indent=2) + "\n")
