"""Train for ten minutes and watch what must not grow: memory, open files, threads; and the speed, which must not fall.

    python benchmarks/soak.py --minutes 10

One run on the insertion task with checkpoints, evaluations and loggers at work, in one process. Once a window the
resident memory, the open files, the threads and the environment steps per second are written down. The first window is
the warm-up: caches fill, the replay buffer's memory is touched. Exit status 1 if between the second window and the last
files or threads grew, memory grew by more than the transitions that were stored explain, or steps per second moved by
more than a tenth.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

SETTINGS = [
    "env=insertion-sim",
    "trainer.total_steps=100000000",
    "trainer.warmup_steps=200",
    "trainer.buffer_capacity=2000",  # full after a few seconds: from then on nothing has a reason to grow
    "trainer.evaluation.every=1000",
    "trainer.evaluation.episodes=10",
    "trainer.evaluation.slots=10",
    "trainer.acceptance.episodes=10",
    "trainer.checkpoint.every=500",
    "logger=[csv,tensorboard]",
    "algorithm=td3",
    "algorithm.agent.network.hidden=[64,64]",
    "render.enabled=false",
]
MEMORY_SLACK = 24.0
"""MiB that the allocators may move by."""

SPEED_SLACK = 0.10
BLINK = 0.25
"""Seconds between two looks at the open files: TensorBoard's own thread opens its file anew for every flush, each
120 s, and closes it; what is open at both looks stays open."""


@dataclass
class Sample:
    """What one window came to."""

    seconds: float
    env_steps: int
    memory: float  # MiB
    files: dict[str, str]  # descriptor to what it is open on
    threads: int
    cpu: float  # seconds
    speed: float = 0.0  # environment steps per second
    cpu_speed: float = (
        0.0  # and per second of this process's own time, which others on the machine disturb less
    )


def sample(start: float, env_steps: int) -> Sample:
    """Look at this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    memory = pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    threads = len(os.listdir("/proc/self/task"))  # noqa: PTH208
    return Sample(
        time.monotonic() - start, env_steps, memory, lasting_files(), threads, time.process_time()
    )


def lasting_files() -> dict[str, str]:
    """Descriptors of this process that are open on the same thing at two looks."""
    before = open_files()
    time.sleep(BLINK)
    now = open_files()
    return {number: target for number, target in now.items() if before.get(number) == target}


def open_files() -> dict[str, str]:
    """Every open descriptor and what it is open on."""
    found = {}
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed since it was listed
            found[descriptor.name] = str(descriptor.readlink())
    return found


def watch(trainer, minutes: float, window: float) -> list[Sample]:
    """Train until the time is over; one sample a window."""
    from rrl.trainers.training.interruption import Interrupted

    start = time.monotonic()
    samples = [sample(start, 0)]
    one_round = trainer._round

    def observed() -> None:
        one_round()
        if time.monotonic() - start < len(samples) * window:
            return
        now, before = sample(start, trainer.env_steps), samples[-1]
        now.speed = (now.env_steps - before.env_steps) / (now.seconds - before.seconds)
        now.cpu_speed = (now.env_steps - before.env_steps) / (now.cpu - before.cpu)
        samples.append(now)
        show(now)
        if now.seconds >= 60 * minutes:
            raise Interrupted(signal.SIGTERM)

    trainer._round = observed
    try:
        trainer.run()
    except Interrupted:
        return samples
    raise SystemExit("the run ended before its time: raise trainer.total_steps")


def show(s: Sample) -> None:
    """Print one line."""
    print(
        f"{s.seconds:7.0f} s {s.env_steps:9d} steps {s.speed:8.1f} steps/s {s.cpu_speed:8.1f} steps/CPU s "
        f"{s.memory:8.1f} MiB {len(s.files):4d} files {s.threads:4d} threads",
        flush=True,
    )


def verdict(samples: list[Sample]) -> list[str]:
    """What grew that must not."""
    first, last = samples[2], samples[-1]
    found = []
    if len(last.files) > len(first.files):
        new = sorted(set(last.files.values()) - set(first.files.values()))
        found.append(
            f"open files grew from {len(first.files)} to {len(last.files)}: {', '.join(new)}"
        )
    if last.threads > first.threads:
        found.append(f"threads grew from {first.threads} to {last.threads}")
    if last.memory - first.memory > MEMORY_SLACK:
        found.append(f"memory grew from {first.memory:.0f} to {last.memory:.0f} MiB")
    if abs(last.speed / first.speed - 1) > SPEED_SLACK:
        found.append(f"speed went from {first.speed:.0f} to {last.speed:.0f} steps/s")
    return found


def main() -> int:
    """Run and judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--window", type=float, default=60.0, help="seconds of one sample")
    arguments = parser.parse_args()
    if arguments.minutes * 60 < 4 * arguments.window:
        parser.error(
            f"expected at least four windows of {arguments.window:g} s, got {arguments.minutes:g} minutes"
        )
    from rrl.trainers.cli.compose import compose
    from rrl.trainers.configuration import build as assembly

    config = compose(SETTINGS)
    with (
        tempfile.TemporaryDirectory() as folder,
        assembly.trainer(config, Path(folder) / "run") as trainer,
    ):
        found = verdict(watch(trainer, arguments.minutes, arguments.window))
        print(f"{threading.active_count()} Python threads at the end")
    print("\n".join(found) or "nothing grew, and the speed stayed")
    return int(bool(found))


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
