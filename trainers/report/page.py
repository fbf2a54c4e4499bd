"""A self-contained HTML page: text, tables, pictures, videos and interactive charts."""

from __future__ import annotations

import base64
import html
import mimetypes
import re
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from ..storage.files import write_atomically

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


class Page:
    """Blocks in reading order, written as one HTML file.

    Everything is inside that file, plotly.js too (4.5 MB, once, and only if there is a chart), so
    that it can be mailed and opened offline. Text is escaped; backticks set it as code.

    Args:
        title: Title of the page and of the browser's tab.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self._sections: list[str] = []
        self._blocks: list[str] = []
        self._charts = 0

    def section(self, title: str) -> None:
        """Start a section: a heading, and an entry in the table of contents."""
        self._sections.append(title)
        self._blocks.append(f'<h2 id="section-{len(self._sections)}">{_text(title)}</h2>')

    def text(self, paragraph: str) -> None:
        """Add a paragraph."""
        self._blocks.append(f"<p>{_text(paragraph)}</p>")

    def table(self, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Add a table.

        Raises:
            ValueError: If a row has another number of cells than the header.
        """
        for row in rows:
            if len(row) != len(header):
                raise ValueError(
                    f"table: expected {len(header)} cells {list(header)}, "
                    f"got {len(row)}: {list(row)}"
                )
        head = "".join(f"<th>{_text(cell)}</th>" for cell in header)
        body = "\n".join(
            "<tr>" + "".join(f"<td>{_text(cell)}</td>" for cell in row) + "</tr>" for row in rows
        )
        content = f"<thead><tr>{head}</tr></thead><tbody>\n{body}\n</tbody>"
        self._blocks.append(f'<div class="wide"><table>{content}</table></div>')

    def image(self, path: Path | str, caption: str = "") -> None:
        """Add a picture (``.png``, ``.jpg``, ``.gif``, ``.svg``).

        Raises:
            ValueError: If the file is of another kind.
        """
        self._figure(
            f'<img alt="{html.escape(caption)}" src="{_data_uri(Path(path), "image")}">', caption
        )

    def video(self, path: Path | str, caption: str = "") -> None:
        """Add a video (``.mp4``, ``.webm``) with controls, or a ``.gif`` that plays by itself.

        Raises:
            ValueError: If the file is of another kind.
        """
        if Path(path).suffix == ".gif":
            self.image(path, caption)
            return
        source = _data_uri(Path(path), "video")
        self._figure(
            f'<video controls loop muted playsinline preload="auto" src="{source}"></video>',
            caption,
        )

    def videos(self, videos: Sequence[tuple[Path | str, str]]) -> None:
        """Add videos with their captions, as many beside one another as there is room for.

        Raises:
            ValueError: If a file is of another kind.
        """
        self._blocks.append('<div class="videos">')
        for path, caption in videos:
            self.video(path, caption)
        self._blocks.append("</div>")

    def chart(self, figure: Figure, caption: str = "") -> None:
        """Add an interactive Plotly figure; its colors follow the reader's light or dark theme."""
        self._charts += 1
        content = figure.to_json().replace("<", "\\u003c")  # it cannot close the script element
        self._figure(
            f'<div class="chart"></div><script type="application/json">{content}</script>', caption
        )

    def details(self, title: str, text: str) -> None:
        """Add preformatted text that a click unfolds."""
        content = f"<summary>{_text(title)}</summary><pre>{html.escape(text, quote=False)}</pre>"
        self._blocks.append(f"<details>{content}</details>")

    def render(self) -> str:
        """Return the page as HTML."""
        contents = "\n".join(
            f'<li><a href="#section-{i}">{_text(t)}</a></li>'
            for i, t in enumerate(self._sections, 1)
        )
        return Template(_resource("page.html")).substitute(
            title=html.escape(self.title),
            contents=contents,
            body="\n".join(self._blocks),
            scripts=_chart_scripts() if self._charts else "",
        )

    def write(self, path: Path | str) -> Path:
        """Write the page, all or nothing.

        Raises:
            IsADirectoryError: If there is a folder of that name.
        """
        path = Path(path)
        if path.is_dir():
            raise IsADirectoryError(f"{path}: expected a file, got a folder; name a file in it")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, self.render())
        return path

    def _figure(self, content: str, caption: str) -> None:
        legend = f"<figcaption>{_text(caption)}</figcaption>" if caption else ""
        self._blocks.append(f"<figure>{content}{legend}</figure>")


def _text(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(str(text), quote=False))


def _data_uri(path: Path, kind: str) -> str:
    media_type = mimetypes.guess_type(path.name)[0] or "unknown"
    if not media_type.startswith(kind):
        raise ValueError(f"{path}: expected a file of type {kind}/*, got {media_type}")
    return f"data:{media_type};base64,{base64.b64encode(path.read_bytes()).decode()}"


def _chart_scripts() -> str:
    from plotly.offline import get_plotlyjs

    return f"<script>{get_plotlyjs()}</script>\n<script>{_resource('page.js')}</script>"


def _resource(name: str) -> str:
    return (Path(__file__).parent / name).read_text(encoding="utf-8")
