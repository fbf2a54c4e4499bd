"""A progress bar with the success so far, or plain lines where the output shows no bars."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bar

from ..console import shows_bars
from ..evaluation.episodes import Comparison
from ..metric_names import decimals

T = TypeVar("T")


class Progress:
    """Shows how far a run is on ``console``."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._bar: Bar | None = None

    @contextmanager
    def training(self, total: int, done: int) -> Iterator[None]:
        """Show a bar over environment steps while the body runs."""
        bar = Bar(
            TextColumn("training"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("steps  {task.fields[status]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self.console,
            disable=self.console.quiet or not shows_bars(self.console),
        )
        with bar, _above_the_bar():
            self._task = bar.add_task("training", total=total or None, completed=done, status="")
            self._bar = bar
            yield
        self._bar = None

    def advance(self, steps: int) -> None:
        """Move the bar."""
        if self._bar is not None:
            self._bar.advance(self._task, steps)

    def show(self, comparison: Comparison, env_steps: int) -> None:
        """Show what an evaluation found."""
        status = describe(comparison)
        if self._bar is not None and shows_bars(self.console):
            self._bar.update(self._task, status=status)
        else:
            self.console.print(f"{env_steps:>8} steps  {status}", highlight=False)

    def track(self, items: Iterable[T], what: str) -> Iterable[T]:
        """Announce every item."""
        for item in items:
            self.console.print(f"{what}: {item}", highlight=False)
            yield item


@contextmanager
def _above_the_bar() -> Iterator[None]:
    """Let log messages pass through the bar, which stands in for stdout and stderr."""
    handlers = [h for h in logging.getLogger().handlers if isinstance(h, logging.StreamHandler)]
    before = {h: h.stream for h in handlers if h.stream in (sys.__stdout__, sys.__stderr__)}
    for handler, stream in before.items():
        handler.setStream(sys.stdout if stream is sys.__stdout__ else sys.stderr)
    try:
        yield
    finally:
        for handler, stream in before.items():
            handler.setStream(stream)


def describe(comparison: Comparison) -> str:
    """Return one line: success of residual, controller and what is handed over, or returns."""
    summary = comparison.summary()
    key = "success" if "success" in summary else "return"
    named = {"residual": key, "controller": f"controller_{key}", "handed over": f"accepted_{key}"}
    shown = {who: summary[entry] for who, entry in named.items() if entry in summary}
    form = ".0%" if key == "success" else f".{decimals(*shown.values())}f"
    parts = [f"{who} {value:{form}}" for who, value in shown.items()]
    return f"{key}: {', '.join(parts)}"
