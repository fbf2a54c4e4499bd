"""What every contender measures of itself, in the same way."""

from __future__ import annotations

import json
import os
import resource
import time
from dataclasses import dataclass, field
from pathlib import Path

TICKS = os.sysconf("SC_CLK_TCK")


def started() -> float:
    """When this process was started, in seconds of ``time.time()``."""
    ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
    boot = next(
        int(line.split()[1])
        for line in Path("/proc/stat").read_text().splitlines()
        if line.startswith("btime")
    )
    return boot + ticks / TICKS


def busiest(processes: list[int]) -> float:
    """Processor seconds of the busiest of ``processes``: what the wall clock of an idle machine could not go below."""
    seconds = []
    for pid in processes:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        seconds.append((int(fields[11]) + int(fields[12])) / TICKS)
    return max(seconds)


@dataclass
class Meter:
    """Marks moments of a run: ``first_update``, and the measured phase of ``steps`` environment steps.

    Attributes:
        warmup: environment steps before the first update.
        settle: steps after it that are not measured (compilation, caches).
        processes: of this run, besides this one.
        curve: seconds since the process's start, and success rate, of every evaluation.

    """

    warmup: int
    settle: int = 200
    processes: list[int] = field(default_factory=list)
    curve: list[tuple[float, float]] = field(default_factory=list)
    first_update: float | None = None
    _begin: tuple[int, float, list[float]] | None = None
    _end: tuple[int, float, list[float]] | None = None
    _paused: float = 0.0

    def step(self, env_steps: int) -> None:
        """Note that ``env_steps`` steps, with the updates that belong to them, are done."""
        if env_steps <= self.warmup:
            return
        if self.first_update is None:
            self.first_update = time.time() - started()
        if env_steps < self.warmup + self.settle:
            return
        pids = [os.getpid(), *self.processes]
        now = env_steps, time.perf_counter() - self._paused, [busiest([pid]) for pid in pids]
        self._begin = self._begin or now
        self._end = now

    def evaluated(self, rate: float, seconds: float) -> None:
        """Note an evaluation that took ``seconds``, which do not count as training time."""
        self._paused += seconds
        self.curve.append((time.time() - started() - self._paused, rate))

    def report(self) -> str:
        """One line of JSON for the driver."""
        assert self._begin and self._end, "the run is too short to be measured"
        steps = self._end[0] - self._begin[0]
        own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
        busy = max(e - b for b, e in zip(self._begin[2], self._end[2], strict=True))
        return json.dumps(
            {
                "steps_per_second": steps / (self._end[1] - self._begin[1]),
                "processor_ms_per_step": 1e3 * busy / steps,
                "first_update_s": self.first_update,
                "peak_mb": (own + children) / 1024,
                "curve": self.curve,
            }
        )
