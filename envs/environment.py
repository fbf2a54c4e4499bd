"""The composer environment of the insertion task."""

from __future__ import annotations

from typing import Any

import dm_env
import numpy as np
from dm_control import composer
from dm_control.rl.control import PhysicsError

from .task import InsertionTask


class InsertionEnvironment(composer.Environment):
    """A composer environment that steps physics as the batched environment does.

    Plain ``mj_step`` (``legacy_step=False``), one compilation for all episodes, and diverged physics as
    a truncated episode with the last finite observation and reward instead of an exception.

    Args:
        task: what to simulate.
        random_state: seed or generator of the resets.
    """

    def __init__(
        self, task: InsertionTask, random_state: int | np.random.RandomState | None = None
    ) -> None:
        config = task.config
        super().__init__(
            task,
            # Half a substep early, because the time is a sum of rounded numbers.
            time_limit=config.episode_length * config.control_timestep - config.physics_timestep / 2,
            random_state=random_state,
            strip_singleton_obs_buffer_dim=True,
            recompile_mjcf_every_episode=False,
            legacy_step=False,
        )

    def step(self, action: Any) -> dm_env.TimeStep:
        """Advances by one control step.

        Raises:
            ValueError: an action of another shape than [3], or one that is not finite.
        """
        try:
            return super().step(action)
        except PhysicsError:
            self.task.after_step(self.physics, self.random_state)
            self._observation_updater.update()
            self._reset_next_step = True
            return dm_env.TimeStep(
                dm_env.StepType.LAST,
                self.task.get_reward(self.physics),
                1.0,
                self._observation_updater.get_observation(),
            )
