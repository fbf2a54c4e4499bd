"""What the terminal shows while runs are under way: runs done, success so far, time left."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from ..console import Output, shows_bars
from ..loggers import metrics
from ..loggers.csv_file import whole_rows
from ..storage.run_files import METRICS
from .job import Job

TAIL_BYTES = 2**16
SPEED_SECONDS = 600.0
"""Time left is judged by the speed of this long."""


class Display:
    """A bar for all runs and one for each under way; plain lines where none are shown."""

    def __init__(self, console: Output) -> None:
        self.console = console
        self._jobs: dict[TaskID, Job] = {}
        self._success: dict[Path, float] = {}

    @contextmanager
    def showing(self, jobs: Sequence[Job], done: Sequence[Job], slots: int) -> Iterator[None]:
        """Show the bars while the body runs."""
        total = sum(job.total_steps for job in jobs)
        self._count, self._ended, self._failed = len(jobs), len(done), 0
        self._ended_steps = sum(job.total_steps for job in done)
        self.console.say(
            f"{len(jobs)} runs, {len(done)} of them finished; {total - self._ended_steps:,} "
            f"environment steps to go, {slots} runs at a time"
        )
        self._bars = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[status]}", markup=False),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self.console,
            disable=not shows_bars(self.console),
            speed_estimate_period=SPEED_SECONDS,
            refresh_per_second=2,
        )
        with self._bars:
            self._all = self._bars.add_task("", total=total or None, status="")
            self.refresh()
            yield

    def started(self, job: Job) -> None:
        """Add a run's bar."""
        if not shows_bars(self.console):
            self.console.say(f"started  {job.name}")
        self._jobs[self._bars.add_task(job.name, total=job.total_steps or None, status="")] = job

    def ended(self, job: Job, done: bool) -> None:
        """Remove a run's bar; what has none was never started."""
        tasks = [task for task, shown in self._jobs.items() if shown is job]
        for task in tasks:
            self._bars.remove_task(task)
            del self._jobs[task]
        word = "done   " if done else "FAILED " if tasks else "NOT STARTED"
        self._ended += 1
        self._failed += bool(tasks) and not done
        self._ended_steps += job.total_steps
        _, success = latest(job.path)
        result = f"success {success:.0%}" if success is not None else ""
        self.console.say(f"{word}  {job.name}  {result}")

    def refresh(self) -> None:
        """Read how far the runs are."""
        if not shows_bars(self.console):
            return
        total = self._ended_steps
        for task, job in self._jobs.items():
            steps, success = latest(job.path)
            if success is not None:
                self._success[job.path] = success
            known = self._success.get(job.path)
            status = f"{steps} of {job.total_steps} steps"
            status += f", success {known:.0%}" if known is not None else ""
            self._bars.update(task, completed=steps, status=status)
            total += steps
        failed = f", {self._failed} failed" if self._failed else ""
        status = f"{self._ended} of {self._count} runs{failed}"
        self._bars.update(self._all, completed=total, description="all runs", status=status)


def latest(run_dir: Path) -> tuple[int, float | None]:
    """Return a run's environment steps, and the last success of the scenario that it follows.

    Only the end of ``metrics.csv`` is read; the success is None if no evaluation is there.
    """
    steps, evaluated, success = 0, -1, None
    for steps, metric, value in whole_rows(_end(run_dir / METRICS)):
        group, _, entry = metric.partition("/")
        first = steps > evaluated  # the followed scenario is evaluated before the others
        followed = first and group == metrics.EVALUATION and entry.count("/") == 1
        if followed and entry.endswith("/success"):
            evaluated, success = steps, value
    return steps, success


def _end(path: Path) -> str:
    """Return the last text of a file; empty if there is none."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - TAIL_BYTES))
            return file.read().decode(errors="replace")
    except OSError:
        return ""
