"""What the terminal shows while runs are under way: runs done, success so far, time left."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from ..experiments.plan import Job
from ..loggers import metrics
from ..storage.run_files import METRICS

TAIL_BYTES = 2**16
SPEED_SECONDS = 600.0
"""Time left is judged by the speed of this long."""


class Display:
    """A bar for all runs and one for each that is under way, or plain lines where the output is no terminal."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self._jobs: dict[TaskID, Job] = {}
        self._success: dict[Path, float] = {}

    @contextmanager
    def showing(self, jobs: Sequence[Job], done: Sequence[Job]) -> Iterator[None]:
        """Show the bars while the body runs."""
        self._count, self._ended, self._failed = len(jobs), len(done), 0
        self._ended_work = sum(job.work for job in done)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[status]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self.console,
            disable=not self.console.is_terminal,
            speed_estimate_period=SPEED_SECONDS,
            refresh_per_second=2,
        )
        with self._bars:
            total = sum(job.work for job in jobs)
            self._all = self._bars.add_task(
                "", total=total or None, completed=self._ended_work, status=""
            )
            self.refresh()
            yield

    def started(self, job: Job) -> None:
        """Add a run's bar."""
        if not self.console.is_terminal:
            self.console.print(f"started  {job.run.name}", highlight=False, soft_wrap=True)
        self._jobs[self._bars.add_task(job.run.name, total=job.total_steps or None, status="")] = (
            job
        )

    def ended(self, job: Job, done: bool) -> None:
        """Remove a run's bar."""
        for task in [task for task, shown in self._jobs.items() if shown is job]:
            self._bars.remove_task(task)
            del self._jobs[task]
        self._ended += 1
        self._failed += not done
        self._ended_work += job.work
        _, success = latest(job.run.path)
        said = f"success {success:.0%}" if success is not None else ""
        word = "done   " if done else "FAILED "
        self.console.print(f"{word}  {job.run.name}  {said}", highlight=False, soft_wrap=True)

    def refresh(self) -> None:
        """Read how far the runs are."""
        if not self.console.is_terminal:
            return
        work = self._ended_work
        for task, job in self._jobs.items():
            steps, success = latest(job.run.path)
            if success is not None:
                self._success[job.run.path] = success
            known = self._success.get(job.run.path)
            status = f"{steps} of {job.total_steps} steps" + (
                f", success {known:.0%}" if known is not None else ""
            )
            self._bars.update(task, completed=steps, status=status)
            work += steps * len(job.run.seeds)
        failed = f", {self._failed} failed" if self._failed else ""
        status = f"{self._ended} of {self._count} runs{failed}"
        self._bars.update(self._all, completed=work, description="all runs", status=status)


def latest(run_dir: Path) -> tuple[int, float | None]:
    """Return the steps so far, and the last followed success near the end of ``metrics.csv``."""
    steps, success = 0, None
    for line in _last_lines(run_dir / METRICS):
        cells = line.split(",")
        if len(cells) != 3 or not cells[0].isdigit():
            continue
        steps = int(cells[0])
        group, _, rest = cells[1].partition("/")
        if group == metrics.EVALUATION and rest.endswith("/success"):
            success = float(cells[2])
    return steps, success


def _last_lines(path: Path) -> list[str]:
    try:
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - TAIL_BYTES))
            return file.read().decode(errors="replace").splitlines()
    except OSError:
        return []
