"""Runs jobs as places become free, each after those it needs; a failed one stops no other."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field

from ..configuration.checks import problems
from ..configuration.target_checks import may_be_robot
from ..console import Output
from ..storage.checkpoints import saved_note
from ..training.interruption import Interruption
from ..training.realtime.hand_over import FOLDER, HandOver
from .display import Display
from .job import Job
from .launchers import GRACE_SECONDS, POLL_SECONDS, Handle, make


@dataclass
class Ending:
    """What became of the jobs.

    Attributes:
        done: Finished, now or before.
        failed: Ended with an error; each run's log says which.
        blocked: Not started, because a run that they need failed.
    """

    done: list[Job] = field(default_factory=list)
    failed: list[Job] = field(default_factory=list)
    blocked: list[Job] = field(default_factory=list)


def launch(
    jobs: Sequence[Job],
    name: str,
    workers: int | None,
    console: Output,
    again: str,
    keep: Callable[[Job], None] = lambda job: None,
) -> Ending:
    """Run what is not finished yet, and show how far it is.

    Args:
        jobs: The runs.
        name: Where they run: ``local`` or ``ray``.
        workers: How many at a time; None: one a core; 0: nothing is run.
        console: Where to show the progress.
        again: The command that goes on after an interruption.
        keep: Called with every run that is finished, once it is.

    Raises:
        Interrupted: By a signal, after every run that was under way has saved itself.
        ValueError: If the configuration of one is wrong, or several would drive a robot side by
            side; none is started.
    """
    ending = Ending(done=[job for job in jobs if job.finished])
    for job in ending.done:
        keep(job)
    if workers == 0:
        console.say(f"{len(jobs)} runs, {len(ending.done)} of them finished; none is run now")
        return ending
    waiting = [job for job in jobs if job not in ending.done]
    _check(waiting)
    _check_robots(waiting, workers)
    running: dict[Handle, Job] = {}
    interruption = Interruption("stopping the runs; each saves itself")
    display = Display(console)
    with (
        closing(make(name, workers)) as launcher,
        interruption.listening(),
        display.showing(jobs, ending.done, launcher.slots),
    ):
        try:
            while (waiting or running) and interruption.signal is None:
                _collect(running, ending, display, keep)
                _block(waiting, ending, display)
                for job in _ready(waiting, ending, launcher.slots - len(running)):
                    waiting.remove(job)
                    job.prepare()
                    running[launcher.start(["train", f"resume={job.path}"], job.log)] = job
                    display.started(job)
                display.refresh()
                time.sleep(POLL_SECONDS)
        finally:
            _stop(running)
    if interruption.signal is not None:
        console.say(f"stopped; to go on:\n  {again}")
    interruption.check()
    return ending


def require_all(ending: Ending, console: Output) -> None:
    """Name the runs that are missing, each with the end of its log.

    Raises:
        RuntimeError: If there are any.
    """
    for job in ending.failed:
        console.say(f"\nFAILED {job.name}: {job.log}", style="red")
        console.say(job.log_tail())
    for job in ending.blocked:
        needs = ", ".join(map(str, job.needs))
        console.say(f"\nNOT STARTED {job.name}: it needs {needs}", style="red")
    if missing := len(ending.failed) + len(ending.blocked):
        failed = len(ending.failed)
        raise RuntimeError(
            f"{missing} runs are missing, {failed} failed; the same command tries them again"
        )


def _check(jobs: Sequence[Job]) -> None:
    """Name every problem once, with the runs that have it; seeds of one folder are alike."""
    found: dict[str, str] = {}
    new = [job for job in jobs if not saved_note(job.path)]
    for folder, job in {job.path.parent: job for job in [*jobs, *new]}.items():
        # What it needs is made first; what has a checkpoint starts from nothing else.
        for problem in problems(job.config, new=job in new and not job.needs):
            found.setdefault(problem, folder.name)
    if found:
        raise ValueError("\n".join(f"{runs}: {problem}" for problem, runs in found.items()))


def _check_robots(jobs: Sequence[Job], workers: int | None) -> None:
    """Refuse runs side by side that drive a robot: each would get the other's commands."""
    robots = [job for job in jobs if may_be_robot(job.config)]
    if len(robots) > 1 and workers != 1:
        got = "null" if workers is None else workers
        raise ValueError(
            f"workers: expected 1, because {len(robots)} runs drive a robot "
            f"({robots[0].config['env']['base']['_target_']}), which takes commands of one at a "
            f"time, got {got}; set workers=1: they run one after the other"
        )


def _ready(waiting: Sequence[Job], ending: Ending, free: int) -> list[Job]:
    """Return the first jobs whose needs are finished.

    The order is the plan's, seed after seed: whoever stops early has equally many seeds everywhere.
    """
    done = {job.path for job in ending.done}
    return [job for job in waiting if done.issuperset(job.needs)][: max(0, free)]


def _collect(
    running: dict[Handle, Job], ending: Ending, display: Display, keep: Callable[[Job], None]
) -> None:
    for handle, job in list(running.items()):
        status = handle.poll()
        if status is None or HandOver(job.path / FOLDER).is_alive():
            continue  # a process that drives a robot goes on where its learner was killed
        del running[handle]
        done = status == 0 and job.finished
        (ending.done if done else ending.failed).append(job)
        display.ended(job, done)
        if done:
            keep(job)


def _block(waiting: list[Job], ending: Ending, display: Display) -> None:
    """Give up the jobs whose needs will not be met."""
    missing = {job.path for job in (*ending.failed, *ending.blocked)}
    for job in [job for job in waiting if missing.intersection(job.needs)]:
        waiting.remove(job)
        ending.blocked.append(job)
        display.ended(job, False)


def _stop(running: dict[Handle, Job]) -> None:
    """Have every run save itself, and end those that do not."""
    for handle in running:
        handle.terminate()
    deadline = time.monotonic() + GRACE_SECONDS
    for handle in running:
        while handle.poll() is None and time.monotonic() < deadline:
            time.sleep(POLL_SECONDS)
        if handle.poll() is None:
            handle.kill()
