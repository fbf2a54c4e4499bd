"""``rrl new NAME``: a project with environment, controller and configuration, ready to train."""

from __future__ import annotations

import keyword
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable  # Python 3.11

PLACEHOLDER = "__project__"
"""Stands for the project's name in the template's file names and texts."""
SUFFIX = ".template"
NO_NAMES = ("null", "true", "false", "nan", "inf")
"""Values in Hydra's grammar."""


def create(name: str, folder: Path) -> list[Path]:
    """Copy the template to ``folder / name``.

    Args:
        name: of the project and of its Python package.
        folder: where the project's folder is made.

    Returns:
        The files that were written.

    Raises:
        ValueError: if ``name`` cannot be imported as a package, is that of one already, or is none
            that an override ``env=NAME`` can have.
        FileExistsError: if there is something of that name already.
    """
    plain = name.isascii() and name.isidentifier() and name.lower() not in NO_NAMES
    if not plain or keyword.iskeyword(name) or name == "configs":
        raise ValueError(
            f"name: expected ASCII that Python can import, such as my_project, got {name!r}"
        )
    target = folder / name
    if target.exists():
        raise FileExistsError(f"{target} exists already: choose another name")
    if find_spec(name) is not None:
        raise ValueError(f"name: expected one that no package has, got {name!r}; choose another")
    return sorted(_copy(files(__package__) / "template", target, name))


def _copy(source: Traversable, target: Path, name: str) -> list[Path]:
    if source.is_file():
        target.parent.mkdir(parents=True, exist_ok=True)
        path = target.with_name(target.name.removesuffix(SUFFIX))
        path.write_text(
            source.read_text(encoding="utf-8").replace(PLACEHOLDER, name), encoding="utf-8"
        )
        return [path]
    return [
        p
        for child in source.iterdir()
        for p in _copy(child, target / child.name.replace(PLACEHOLDER, name), name)
    ]
