"""The page of an experiment with a task for every arm, in Markdown: for a repository's docs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..storage.files import write_atomically
from .outcomes import Finding
from .spec import Experiment
from .standing import HEADER, notes, standing_row

__all__ = ["write_page"]


def write_page(experiment: Experiment, finding: Finding, folder: Path) -> Path:
    """Write ``NAME.md``, which shows the figure ``figures/NAME.png`` beside it; return its path."""
    rows = [standing_row(outcome) for outcome in finding.outcomes]
    blocks = [
        f"# {experiment.title}",
        f"`rrl reproduce {experiment.name}` wrote this page. The numbers behind the figure are in "
        f"`figures/{experiment.name}.csv`; configurations and videos are in "
        f"`report-{experiment.name}.html`.",
        f"![Over environment steps, a panel for every task](figures/{experiment.name}.png)",
        "\n".join(_row(cells) for cells in (HEADER, ["---"] * len(HEADER), *rows)),
        *notes(finding),
    ]
    path = folder / f"{experiment.name}.md"
    write_atomically(path, "\n\n".join(blocks) + "\n")
    return path


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
