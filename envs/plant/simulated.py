"""The insertion task as a machine: it moves in wall-clock time, whether or not anybody commands."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rrl.keys import DIVERGED
from rrl.robot import Description, EntrySpec, Observation, Robot

from ..insertion import quantities
from ..insertion.config import InsertionConfig
from ..insertion.model.scene import compile_model
from ..insertion.physics.control import check_action
from ..insertion.physics.start import StartState, draw_episode

MOST_BEHIND = 0.5
"""Seconds that physics makes up for at once; a process that slept longer has stood still."""


class SimulatedPlant(Robot):
    """The block-insertion task in wall-clock time.

    Without a new command the last one is executed again in every control period, until ``timeout``
    has passed since it came; then the arm stands still. Physics that diverges ends the episode as
    truncated.

    Args:
        config: The task.
        timeout: Seconds after which a command is no longer executed.
    """

    def __init__(self, config: InsertionConfig, timeout: float = 0.2) -> None:
        self.config, self.timeout = config, timeout
        self._model = compile_model(config)
        self._start = StartState(self._model, config)
        self._data = mujoco.MjData(self._model)
        self._trace: deque[NDArray[np.float64]] = deque(maxlen=config.substeps)
        self._began = time.monotonic()
        self.reset(0)
        entries = {n: EntrySpec(v.shape, str(v.dtype)) for n, v in self._outputs.items()}
        self.description = Description(entries, (-1.0,) * 3, (1.0,) * 3, config.control_timestep)

    def observe(self) -> Observation:
        """Return what is measured now."""
        self.advance()
        return Observation(dict(self._outputs), self._now - self._began)

    def command(self, action: NDArray[Any]) -> None:
        """Set the tool's goal ``action`` [3] times ``action_scale`` [m] from where it is."""
        self.advance()
        self._action = check_action(np.asarray(action, dtype=np.float64)[None], 1)
        self._commanded = time.monotonic()
        self._execute()

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode at once."""
        episode = draw_episode(self.config, np.random.default_rng(seed))
        self._start.begin(self._model, self._data, episode)
        self._trace.clear()
        self._diverged, self._now = False, time.monotonic()
        self._measure()
        self.stop()

    def stop(self) -> None:
        """Hold the tool where it is."""
        self._action, self._commanded = np.zeros((1, 3)), float("inf")
        self._execute()

    def advance(self) -> float:
        """Bring physics up to now; return after how many seconds at most to do so again."""
        step, now = self.config.physics_timestep, time.monotonic()
        self._now = max(self._now, now - MOST_BEHIND)
        moved = False
        while self._now + step <= now:
            self._repeat()
            if not self._diverged:
                before = self._data.time
                mujoco.mj_step(self._model, self._data)
                self._diverged = self._data.time < before + step / 2  # MuJoCo began anew
                self._trace.append(self._data.sensordata.copy())
            self._now, moved = self._now + step, True
        if moved:
            self._measure()
        return 0.005

    def _repeat(self) -> None:
        """Execute the last command again, or stop."""
        if self._now - self._commanded > self.timeout:
            self.stop()
        elif self._now >= self._repeat_at:
            self._execute()

    def _execute(self) -> None:
        self._data.ctrl[:] = self._start.controls(self._data.sensordata[None], self._action)[0]
        self._repeat_at = time.monotonic() + self.config.control_timestep * 1.2
        if not np.isfinite(self._data.ctrl).all():
            self._diverged = True

    def _measure(self) -> None:
        """Evaluate the last control period, unless physics has failed."""
        speed = np.abs(self._data.qvel).max()
        self._diverged |= not speed <= self.config.velocity_limit  # also for NaN
        if not self._diverged:
            trace = np.stack(self._trace or [self._data.sensordata])[None]  # (1, substeps, n)
            values = quantities.evaluate(
                self._start.layout.views(trace), self._start.tare, self.config
            )
            self._outputs = {name: _single(value) for name, value in values.items()}
        ended = np.array([self._diverged])
        self._outputs |= {DIVERGED: ended, "truncated": ended}


def _single(value: NDArray[Any]) -> NDArray[Any]:
    return value[0] if value.dtype == bool else value[0].astype(np.float32)
