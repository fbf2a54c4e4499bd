"""The block-insertion task for dm_control's composer."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from dm_control import composer
from dm_control.composer.observation import observable
from dm_env import specs

from rrl.keys import DIVERGED, REWARD_TERMS, SUCCESS

from . import quantities
from .config import InsertionConfig
from .model.scene import build_scene
from .physics.control import check_action, set_points
from .physics.simulation import STATE, has_diverged
from .physics.start import StartState, draw_episode
from .quantities import Measurement


class InsertionTask(composer.Task):
    """Insert the held block between two standing blocks without toppling them.

    Physics, observation, reward and success are those of :class:`~rrl.envs.InsertionEnv`; given the
    same episode and actions both run the same trajectory. Needs a composer environment with
    ``legacy_step=False`` (see :func:`rrl.envs.load`).

    Args:
        config: the task's settings.
    """

    def __init__(self, config: InsertionConfig) -> None:
        self.config = config.validate()
        self._scene = build_scene(config)
        self._start: StartState | None = None
        self._trace: list[np.ndarray] = []
        self._sensors = np.zeros(0)
        self._start_time = np.zeros(1)
        self._measurement: Measurement | None = None
        self._diverged = False
        self.num_diverged = 0
        self.set_timesteps(config.control_timestep, config.physics_timestep)
        self._observables = self._make_observables()

    @property
    def root_entity(self) -> composer.Entity:
        """The arena."""
        return self._scene.arena

    @property
    def task_observables(self) -> OrderedDict:
        """Observation of the task, the same keys as the batched environment's."""
        return self._observables

    @property
    def measurement(self) -> Measurement:
        """What the last control step showed, batch of one."""
        if self._measurement is None:
            raise RuntimeError("nothing has been measured yet: reset the environment first")
        return self._measurement

    def _make_observables(self) -> OrderedDict:
        config = self.config

        def entry(function: Callable[[Measurement], np.ndarray]) -> observable.Generic:
            result = observable.Generic(lambda physics: function(self.measurement))
            result.enabled = True
            return result

        def part(name: str) -> observable.Generic:
            return entry(lambda m: quantities.observation(m, config)[name][0])

        def term(name: str) -> observable.Generic:
            return entry(lambda m: quantities.reward_terms(m, config)[name])

        result = OrderedDict((name, part(name)) for name in quantities.observation_sizes(config))
        result["contact_force"] = entry(lambda m: m.contact_force.copy())
        result["tilt"] = entry(lambda m: m.inclination.max(axis=-1))
        result[SUCCESS] = entry(lambda m: quantities.success(m, config))
        result[DIVERGED] = entry(lambda m: np.array([self._diverged]))
        for name in quantities.reward_term_names(config):
            result[f"{REWARD_TERMS}/{name}"] = term(name)
        return result

    def action_spec(self, physics: Any) -> specs.BoundedArray:
        """Normalised displacement (x, y, z) in [-1, 1]."""
        del physics
        return specs.BoundedArray((3,), np.float64, -1.0, 1.0, name="x\ty\tz")

    def after_compile(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Finds the start state for the compiled model."""
        del random_state
        if self._start is None:
            self._start = StartState(physics.model.ptr, self.config)
        self.initialize_episode(physics, np.random.RandomState(0))
        self._measure(physics)

    def initialize_episode(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Draws an episode and puts the physics at its start."""
        model, data = physics.model.ptr, physics.data.ptr
        episode = draw_episode(self.config, random_state)
        self._diverged = False
        self._trace = []
        self.start.set_yaw(model, episode.yaw)
        self.start.hold(model, data, self.start.qpos(model, episode))
        self._measure(physics)

    @property
    def start(self) -> StartState:
        """The nominal start of an episode."""
        if self._start is None:
            raise RuntimeError("the model is not compiled yet: make a composer.Environment first")
        return self._start

    def before_step(
        self, physics: Any, action: np.ndarray, random_state: np.random.RandomState
    ) -> None:
        """Turns the action into set points.

        Raises:
            ValueError: an action of another shape than [3], or one that is not finite.
        """
        del random_state
        action = check_action(np.asarray(action, dtype=np.float64)[None], 1)
        signals = self.start.layout.views(self._sensors[None])
        controls = set_points(signals, action, self.config, self.start.home)
        physics.data.ctrl[:] = controls[0]
        # The batched environment starts every control step without warm start.
        physics.data.qacc_warmstart[:] = 0
        self._trace = []
        self._start_time = np.array([physics.data.time])

    def after_substep(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Keeps the sensors of every substep."""
        del random_state
        self._trace.append(physics.data.sensordata.copy())

    def after_step(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Measures the end of the control step; a diverged one leaves the last measurement."""
        del random_state
        model, data = physics.model.ptr, physics.data.ptr
        state = np.empty((1, mujoco.mj_stateSize(model, STATE)))
        mujoco.mj_getState(model, data, state[0], STATE)
        self._diverged = bool(has_diverged(state, self._start_time, model, self.config)[0])
        if self._diverged:
            self.num_diverged += 1
        else:
            self._measure(physics)

    def _measure(self, physics: Any) -> None:
        trace = np.array(self._trace) if self._trace else physics.data.sensordata.copy()[None]
        self._trace = []
        self._sensors = trace[-1]
        tare = self.start.tare
        self._measurement = quantities.measure(self.start.layout.views(trace[None]), tare)

    def get_reward(self, physics: Any) -> float:
        """Sum of the weighted reward terms."""
        del physics
        return float(quantities.total(quantities.reward_terms(self.measurement, self.config))[0])

    def should_terminate_episode(self, physics: Any) -> bool:
        """Only diverged physics ends an episode before its time."""
        del physics
        return self._diverged
