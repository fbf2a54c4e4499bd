"""The block-insertion task for dm_control's composer, and as an environment by name."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import mujoco
import numpy as np
from dm_control import composer
from dm_control.composer.observation import observable
from dm_env import specs

from rrl.keys import DIVERGED, REWARD

from . import quantities
from .config import PRESETS, InsertionConfig, make_config
from .model.scene import build_scene
from .physics.control import check_action
from .physics.simulation import STATE, has_diverged
from .physics.start import StartState, draw_episode

_PREFIX = "insertion-"
NAMES = tuple(_PREFIX + variant for variant in PRESETS)
"""What :func:`load` takes."""


class InsertionTask(composer.Task):
    """Insert the held block between two standing blocks without toppling them.

    Physics, observation, reward and success are those of :class:`~rrl.envs.InsertionEnv`; given the
    same episode and actions both run the same trajectory. Needs a composer environment with
    ``legacy_step=False`` (see :func:`rrl.envs.load`).

    Args:
        config: The task's settings.
    """

    def __init__(self, config: InsertionConfig) -> None:
        self.config = config
        self._arena = build_scene(config)
        self._trace: list[np.ndarray] = []
        self._sensors = np.zeros(0)
        self._start_time = np.zeros(1)
        self._outputs: dict[str, np.ndarray] = {}
        self.set_timesteps(config.control_timestep, config.physics_timestep)
        self._observables = OrderedDict()
        for name in (*quantities.output_names(config), DIVERGED):
            read = observable.Generic(lambda physics, name=name: self._outputs[name][0])
            read.enabled = True
            self._observables[name] = read

    @property
    def root_entity(self) -> composer.Entity:
        """The arena."""
        return self._arena

    @property
    def task_observables(self) -> OrderedDict:
        """What the batched environment writes, nested names as ``group/name``."""
        return self._observables

    def action_spec(self, physics: Any) -> specs.BoundedArray:
        """Return the spec of the normalized displacement (x, y, z) in [-1, 1]."""
        return specs.BoundedArray((3,), np.float64, -1.0, 1.0, name="x\ty\tz")

    def after_compile(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Find the start state for the compiled model."""
        self._start = StartState(physics.model.ptr, self.config)
        self.initialize_episode(physics, np.random.RandomState(0))

    def initialize_episode(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Draw an episode and put the physics at its start."""
        model, data = physics.model.ptr, physics.data.ptr
        episode = draw_episode(self.config, random_state)
        self._start.begin(model, data, episode)
        self._trace = [data.sensordata.copy()]
        self._evaluate()

    def before_step(
        self, physics: Any, action: np.ndarray, random_state: np.random.RandomState
    ) -> None:
        """Turn the action into set points.

        Raises:
            ValueError: If the action is not of shape [3], or not finite.
        """
        action = check_action(np.asarray(action, dtype=np.float64)[None], 1)
        physics.data.ctrl[:] = self._start.controls(self._sensors[None], action)[0]
        # The batched environment starts every control step without warm start.
        physics.data.qacc_warmstart[:] = 0
        self._trace = []
        self._start_time = np.array([physics.data.time])

    def after_substep(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Keep the sensors of every substep."""
        self._trace.append(physics.data.sensordata.copy())

    def after_step(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Evaluate the end of the control step; a diverged one leaves the last outputs."""
        model, data = physics.model.ptr, physics.data.ptr
        state = np.empty((1, mujoco.mj_stateSize(model, STATE)))
        mujoco.mj_getState(model, data, state[0], STATE)
        if has_diverged(state, self._start_time, model, self.config)[0]:
            self._outputs[DIVERGED] = np.array([[True]])
        else:
            self._evaluate()

    def _evaluate(self) -> None:
        trace = np.array(self._trace)
        self._sensors = trace[-1]
        signals = self._start.layout.views(trace[None])
        self._outputs = quantities.evaluate(signals, self._start.tare, self.config)
        self._outputs[DIVERGED] = np.array([[False]])

    def get_reward(self, physics: Any) -> float:
        """Return the sum of the weighted reward terms."""
        return float(self._outputs[REWARD][0, 0])

    def should_terminate_episode(self, physics: Any) -> bool:
        """Return whether the physics diverged; nothing else ends an episode before its time."""
        return bool(self._outputs[DIVERGED][0, 0])


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
        self._hooks.before_substep(self.physics, action, self.random_state)
        mujoco.mj_step(self.physics.model.ptr, self.physics.data.ptr)
        self._hooks.after_substep(self.physics, self.random_state)


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
