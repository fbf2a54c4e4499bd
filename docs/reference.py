"""Builds the API reference from the docstrings into build/reference; any warning of the builder is an error."""

from __future__ import annotations

import argparse
import os
import pkgutil
import warnings
from importlib import import_module
from pathlib import Path

PACKAGES = (
    "rrl",
    "rrl.algorithms",
    "rrl.controllers",
    "rrl.transforms",
    "rrl.envs",
    "rrl.trainers",
)
INSIDE = ("rrl.trainers", "rrl.trainers.experiments")
"""Packages whose modules have pages of their own, beside the names that the package exports."""

WITHOUT_PAGE = ("rrl.trainers.__main__",)


def modules() -> list[str]:
    """Every page of the reference."""
    found = [
        m.name
        for package in INSIDE
        for m in pkgutil.iter_modules(import_module(package).__path__, f"{package}.")
    ]
    return [*PACKAGES, *(name for name in found if name not in WITHOUT_PAGE)]


def build(out: Path) -> None:
    """Write the pages.

    Raises:
        Warning: whatever the builder finds, such as a name in ``__all__`` or in an annotation that does not exist.
    """
    os.environ["PDOC_ALLOW_EXEC"] = (
        "1"  # MuJoCo's window library looks for itself in a process of its own
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the imports
        import pdoc

        names = modules()
        trainers = import_module("rrl.trainers")
        for name in trainers.__all__:
            setattr(trainers, name, getattr(trainers, name))  # they are loaded at first use
        for name in names:
            import_module(name)
        warnings.simplefilter("ignore", DeprecationWarning)  # of what the builder imports itself
        warnings.simplefilter("error", UserWarning)
        warnings.filterwarnings(
            "ignore", message="The module specification .* has already been added"
        )
        # what our classes inherit: TorchRL imports these names for its type checker alone
        warnings.filterwarnings(
            "ignore", message=".*(BaseCollector|LLMCollector|_AcceptedKeys|PydanticDataclass)"
        )
        pdoc.render.configure(docformat="google", footer_text="rrl")
        pdoc.pdoc(*names, output_directory=out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/reference"))
    folder = parser.parse_args().out
    build(folder)
    print(f"  {folder / 'index.html'}")
