"""Where the time of a run goes: ``rrl train trainer.profile=true``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.table import Table
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import TransformedEnv

from ..loggers import metrics

NESTED = {"sample": "update", "compile": "update"}
"""Sections that another one contains."""

BACKGROUND = "background"
"""The section of what a second process does meanwhile; no part of the sum."""


class Stopwatch:
    """Adds up the seconds spent in named sections since the last :meth:`lap`."""

    def __init__(self) -> None:
        self._sections: dict[str, float] = {}

    @contextmanager
    def __call__(self, section: str) -> Iterator[None]:
        """Time the body of a ``with`` statement."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(section, time.perf_counter() - start)

    def add(self, section: str, seconds: float) -> None:
        """Count seconds that were measured elsewhere."""
        if seconds:
            self._sections[section] = self._sections.get(section, 0.0) + seconds

    def lap(self) -> dict[str, float]:
        """Return the seconds by section and start anew."""
        sections, self._sections = self._sections, {}
        return sections


def watch_collection(env: TransformedEnv, modules: Mapping[str, TensorDictModuleBase]) -> Stopwatch:
    """Time the parts of a collection: the bare environment, each transform, each module.

    What the collector, TensorDict and TorchRL's environment classes need beyond that is the rest of
    ``time/collect``.
    """
    stopwatch = Stopwatch()
    _time(stopwatch, env.base_env, "_step", "collect/environment")
    _time(stopwatch, env.base_env, "_reset", "collect/reset")
    for transform in env.transform:
        for method in ("_step", "_inv_call", "_reset"):
            _time(stopwatch, transform, method, f"collect/{type(transform).__name__}")
    for name, module in modules.items():
        _time(stopwatch, module, "forward", f"collect/{name}")
    return stopwatch


def _time(stopwatch: Stopwatch, owner: Any, method: str, section: str) -> None:
    original: Callable[..., Any] = getattr(owner, method)

    def timed(*args: Any, **kwargs: Any) -> Any:
        with stopwatch(section):
            return original(*args, **kwargs)

    object.__setattr__(owner, method, timed)


class Profile:
    """Adds up the ``time/*`` metrics of the rounds that are done, from the first update on."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.env_steps = 0

    def add(self, values: metrics.Values, env_steps: int) -> None:
        """Take the metrics of a round of ``env_steps`` steps, unless it had no update."""
        prefix = f"{metrics.TIME}/"
        times = {key.removeprefix(prefix): v for key, v in values.items() if key.startswith(prefix)}
        if "update" not in times:
            return
        self.env_steps += env_steps
        for section, seconds in times.items():
            self.seconds[section] = self.seconds.get(section, 0.0) + seconds

    def rows(self) -> list[tuple[str, float]]:
        """Sections and their milliseconds an environment step, the parts of one below it."""
        per_step = {
            section: 1e3 * s / max(1, self.env_steps) for section, s in self.seconds.items()
        }
        for part, whole in NESTED.items():
            if part in per_step and whole in per_step:
                per_step[whole] -= per_step[part]
        tops = [section for section in per_step if "/" not in section]
        rows = []
        for top in sorted(tops, key=lambda s: (s == BACKGROUND, -per_step[s])):
            parts = sorted(
                (s for s in per_step if s.startswith(f"{top}/")), key=lambda s: -per_step[s]
            )
            rows.append((top, per_step[top]))
            rows += [(f"  {part.partition('/')[2]}", per_step[part]) for part in parts]
            if parts:
                rows.append(("  the rest", per_step[top] - sum(per_step[part] for part in parts)))
        return rows

    def table(self) -> Table:
        """Return :meth:`rows` for the terminal; what a second process did stands below the sum."""
        rows = self.rows()
        end = next((i for i, (name, _) in enumerate(rows) if name == BACKGROUND), len(rows))
        total = sum(value for name, value in rows[:end] if not name.startswith(" "))
        title = f"where the time went ({self.env_steps} steps with updates)"
        table = Table("section", "ms a step", "share", title=title)
        for name, value in [*rows[:end], ("sum", total), *rows[end:]]:
            table.add_row(name, f"{value:.3f}", f"{value / total:.0%}" if total else "")
        return table


def measured(stopwatch: Stopwatch | None) -> dict[str, float]:
    """Return what a stopwatch has measured since the last time, as metrics."""
    times = {} if stopwatch is None else stopwatch.lap()
    return {metrics.name(metrics.TIME, section): seconds for section, seconds in times.items()}


def as_background(values: Mapping[str, float], seconds: float) -> dict[str, float]:
    """Return the metrics of a collection that took ``seconds`` in a second process, renamed."""
    collect, there = metrics.name(metrics.TIME, "collect"), metrics.name(metrics.TIME, BACKGROUND)
    renamed = {
        there + key.removeprefix(collect) if key.startswith(collect) else key: value
        for key, value in values.items()
    }
    return renamed | {there: seconds}
