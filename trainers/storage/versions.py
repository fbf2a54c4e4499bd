"""Which software a run was made with."""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from platform import platform, python_version

from .files import write_atomically
from .run_files import VERSIONS

PACKAGES = ("rrl", "torch", "torchrl", "tensordict", "mujoco", "dm-control", "gymnasium", "numpy")


def versions(further: Iterable[str] = ()) -> dict[str, str]:
    """Versions of Python, of the platform and of the packages that decide what a run computes.

    Args:
        further: Names of packages that the run's environment needs.
    """
    found = {"python": python_version(), "platform": platform()}
    known = {package: _version(package) for package in (*PACKAGES, *further)}
    return found | {package: version for package, version in known.items() if version}


def missing(packages: Iterable[str]) -> list[str]:
    """Return the packages that are not installed."""
    return [package for package in packages if _version(package) is None]


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except (metadata.PackageNotFoundError, ValueError):  # the second: no name at all
        return None


def write_versions(run_dir: Path, further: Iterable[str] = ()) -> None:
    """Write ``versions.json``; a resumed run keeps the newest."""
    write_atomically(run_dir / VERSIONS, json.dumps(versions(further), indent=2) + "\n")
