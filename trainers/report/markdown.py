"""A Markdown page of the same blocks as the HTML page: for a repository's documents."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from ..storage.files import write_atomically


class MarkdownPage:
    """Headings, text, tables and pictures in reading order, written as one Markdown file.

    Pictures stay files of their own: the page is moved together with the folders that it names.

    Args:
        title: Heading of the page.
    """

    def __init__(self, title: str) -> None:
        self._blocks = [f"# {title}"]

    def section(self, title: str) -> None:
        """Start a section."""
        self._blocks.append(f"## {title}")

    def text(self, paragraph: str) -> None:
        """Add a paragraph."""
        self._blocks.append(paragraph)

    def table(self, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table."""
        self._blocks.append(markdown_table(header, rows))

    def image(self, path: Path | str, caption: str = "") -> None:
        """Add a picture; its path is relative to the page."""
        self._blocks.append(f"![{caption}]({quote(Path(path).as_posix())})")

    def write(self, path: Path) -> Path:
        """Write the page, all or nothing."""
        write_atomically(path, "\n\n".join(self._blocks) + "\n")
        return path


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown; bars and line breaks in cells are kept from ending them."""
    return "\n".join(map(_row, (header, ["---"] * len(header), *rows)))


def _row(cells: Sequence[str]) -> str:
    escaped = (" ".join(str(cell).split()).replace("|", "\\|") for cell in cells)
    return f"| {' | '.join(escaped)} |"
