"""``rrl new NAME``: a project with environment, controller and configuration, ready to train."""

from __future__ import annotations

import keyword
from importlib.util import find_spec
from pathlib import Path

TEMPLATE = Path(__file__).parent / "template"
PLACEHOLDER = "__project__"
"""Stands for the project's name in the template's file names and texts."""
SUFFIX = ".template"
NO_NAMES = ("null", "true", "false", "nan", "inf")
"""Values in Hydra's grammar."""


def create(name: str, folder: Path) -> list[Path]:
    """Copy the template to ``folder / name``.

    Args:
        name: Of the project and of its Python package.
        folder: Where the project's folder is made.

    Returns:
        The files that were written.

    Raises:
        ValueError: If ``name`` cannot be imported as a package, is that of one already, or is none
            that an override ``env=NAME`` can have.
        FileExistsError: If there is something of that name already.
    """
    plain = name.isascii() and name.isidentifier() and name.lower() not in NO_NAMES
    if not plain or keyword.iskeyword(name) or name == "configs":
        raise ValueError(
            f"name: expected ASCII that Python can import, such as my_project, got {name!r}"
        )
    target = folder / name
    if target.exists():
        raise FileExistsError(f"name: expected a new one, got {name!r}: {target} exists already")
    if find_spec(name) is not None:
        raise ValueError(f"name: expected one that no package has, got {name!r}; choose another")
    written = []
    for source in (path for path in TEMPLATE.rglob("*") if path.is_file()):
        relative = str(source.relative_to(TEMPLATE)).replace(PLACEHOLDER, name)
        path = target / relative.removesuffix(SUFFIX)
        path.parent.mkdir(parents=True, exist_ok=True)
        text = source.read_text(encoding="utf-8").replace(PLACEHOLDER, name)
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return sorted(written)
