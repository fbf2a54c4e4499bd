"""Runs jobs as places become free: each after those it needs, a failed one without stopping the others."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from ..experiments.plan import Job, quoted
from ..training.interruption import Interruption
from .display import Display
from .launchers import GRACE_SECONDS, POLL_SECONDS, Handle, Launcher
from .store import Store, StoredRun


@dataclass
class Ending:
    """What became of the jobs.

    Attributes:
        done: finished, now or before.
        failed: ended with an error; each run's log says which.
        blocked: not started, because a run that they need failed.
    """

    done: list[Job] = field(default_factory=list)
    failed: list[Job] = field(default_factory=list)
    blocked: list[Job] = field(default_factory=list)


def run_jobs(jobs: Sequence[Job], store: Store, launcher: Launcher, display: Display) -> Ending:
    """Run what is not finished yet.

    Raises:
        Interrupted: by SIGTERM or Ctrl-C, after every run that was under way has saved itself.
    """
    ending = Ending(done=[job for job in jobs if job.run.finished])
    waiting = [job for job in jobs if not job.run.finished]
    running: dict[Handle, Job] = {}
    interruption = Interruption("stopping the runs; each saves itself")
    with interruption.listening(), display.showing(jobs, ending.done):
        try:
            while (waiting or running) and interruption.signal is None:
                _collect(running, ending, display)
                _block(waiting, ending, display)
                for job in _ready(waiting, launcher.slots - len(running)):
                    waiting.remove(job)
                    running[_start(job, store, launcher)] = job
                    display.started(job)
                display.refresh()
                time.sleep(POLL_SECONDS)
        finally:
            _stop(running)
    interruption.check()
    return ending


def arguments(job: Job) -> list[str]:
    """The command of a job after ``rrl``: a new run, or the continuation of the one that is there."""
    if job.run.started:
        return ["train", f"resume={job.run.path}"]
    return ["train", *job.overrides, f"hydra.run.dir={quoted(job.run.path)}"]


def _start(job: Job, store: Store, launcher: Launcher) -> Handle:
    store.register(job.run, job.overrides)
    return launcher.start(arguments(job), job.run.log)


def _ready(waiting: Sequence[Job], free: int) -> list[Job]:
    """Jobs whose needs are finished; those that others wait for first, then the longest."""
    needed = {run.path for job in waiting for run in job.needs}
    able = [job for job in waiting if all(run.finished for run in job.needs)]
    return sorted(able, key=lambda job: (job.run.path not in needed, -job.work))[: max(0, free)]


def _collect(running: dict[Handle, Job], ending: Ending, display: Display) -> None:
    for handle, job in list(running.items()):
        status = handle.poll()
        if status is None:
            continue
        del running[handle]
        done = status == 0 and job.run.finished
        (ending.done if done else ending.failed).append(job)
        display.ended(job, done)


def _block(waiting: list[Job], ending: Ending, display: Display) -> None:
    """Give up the jobs whose needs will not be met."""
    hopeless = _paths([*ending.failed, *ending.blocked])
    for job in [job for job in waiting if hopeless & {run.path for run in job.needs}]:
        waiting.remove(job)
        ending.blocked.append(job)
        display.ended(job, False)


def _paths(jobs: Iterable[Job]) -> set:
    return {job.run.path for job in jobs}


def _stop(running: dict[Handle, Job]) -> None:
    """Have every run save itself, and end those that do not."""
    for handle in running:
        handle.stop()
    deadline = time.monotonic() + GRACE_SECONDS
    for handle in running:
        while handle.poll() is None and time.monotonic() < deadline:
            time.sleep(POLL_SECONDS)
        if handle.poll() is None:
            handle.kill()


def tail(run: StoredRun, lines: int = 15) -> str:
    """The end of a run's log."""
    try:
        return "\n".join(
            run.log.read_text(encoding="utf-8", errors="replace").splitlines()[-lines:]
        )
    except OSError as error:
        return str(error)
