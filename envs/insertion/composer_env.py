"""The insertion task as a composer environment, by name."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from dm_control import composer

from .composer_task import InsertionTask
from .config import PRESETS, make_config

__all__ = ["NAMES", "InsertionEnvironment", "load"]

_PREFIX = "insertion-"
NAMES = tuple(_PREFIX + variant for variant in PRESETS)
"""What :func:`load` takes."""


class InsertionEnvironment(composer.Environment):
    """A composer environment that steps physics as the batched environment does.

    Plain ``mj_step`` (``legacy_step=False``), one compilation for all episodes, and diverged
    physics as a truncated episode with the last finite observation and reward instead of an
    exception.

    Args:
        task: What to simulate.
        random_state: Seed or generator of the resets.
    """

    def __init__(
        self, task: InsertionTask, random_state: int | np.random.RandomState | None = None
    ) -> None:
        config = task.config
        duration = config.episode_length * config.control_timestep
        super().__init__(
            task,
            # Half a substep early, because the time is a sum of rounded numbers.
            time_limit=duration - config.physics_timestep / 2,
            random_state=random_state,
            strip_singleton_obs_buffer_dim=True,
            recompile_mjcf_every_episode=False,
            legacy_step=False,
        )

    def _substep(self, action: Any) -> None:
        # As composer does it, but without dm_control's check, which raises in the middle of the
        # control step: the task looks at its end and flags what has diverged.
        self._hooks.before_substep(self._physics_proxy, action, self._random_state)
        mujoco.mj_step(self._physics.model.ptr, self._physics.data.ptr)
        self._hooks.after_substep(self._physics_proxy, self._random_state)


def load(
    name: str, random_state: int | np.random.RandomState | None = None, **overrides: Any
) -> InsertionEnvironment:
    """Return a composer environment.

    Args:
        name: One of :data:`NAMES`.
        random_state: Seed or generator of the resets.
        overrides: Fields of :class:`~rrl.envs.InsertionConfig` to replace.

    Raises:
        ValueError: If the name or a setting is unknown; the message lists the choices.
    """
    if name not in NAMES:
        raise ValueError(f"name: expected one of {list(NAMES)}, got {name!r}")
    config = make_config(name.removeprefix(_PREFIX), overrides)
    return InsertionEnvironment(InsertionTask(config), random_state=random_state)
