"""A batch of MuJoCo simulations stepped in C, without Python between substeps."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from mujoco import rollout

from ..config import InsertionConfig
from ..model.scene import compile_model
from .start import Episode, StartState

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
CONTROL = mujoco.mjtState.mjSTATE_CTRL.value


def has_diverged(
    state: np.ndarray, start_time: np.ndarray, model: mujoco.MjModel, config: InsertionConfig
) -> np.ndarray:
    """Return which full physics states [B, nstate] do not end a regular control step, [B] bool.

    They are not finite or impossibly fast, or MuJoCo found them bad on the way: it then resets the
    simulation (and ``rollout`` stops), which shows in the time since ``start_time`` [B].
    """
    velocity = state[:, 1 + model.nq : 1 + model.nq + model.nv]
    slow = np.abs(velocity).max(axis=1) <= config.velocity_limit  # False for NaN
    elapsed = state[:, 0] - start_time
    on_time = np.abs(elapsed - config.control_timestep) < 0.5 * config.physics_timestep
    return ~(slow & on_time & np.isfinite(state).all(axis=1))


class BatchSimulation:
    """B independent copies of one model, advanced by ``mujoco.rollout``.

    Every control step starts from the full physics state without warm start, so that it depends on
    nothing but state and control: slots, threads and restored states cannot influence each other.

    Args:
        config: The task's settings.
        num_envs: B.
        num_threads: 1 runs in the calling thread; more make a pool that lives as long as this.

    Attributes:
        models: The model of each environment.
        state: Full physics state: time, positions, velocities, [B, nstate].
        sensors: Sensordata of the last substep, [B, n].
        yaw: Yaw of the left and right standing block at the last reset, [B, 2] [rad].
        place: How far they stood from where the robot believes them, x and y, [B, 2] [m].
        start: The nominal start of an episode.
    """

    def __init__(self, config: InsertionConfig, num_envs: int, num_threads: int) -> None:
        model = compile_model(config)
        self.config = config
        self.start = StartState(model, config)
        # Per-environment models exist only where part of an episode is part of the model.
        shared = not self.start.yaw_in_model and not any(config.place_range)
        self.models = [model if shared else copy.copy(model) for _ in range(num_envs)]
        self._data = [mujoco.MjData(model) for _ in range(num_threads)]
        self._rollout = rollout.Rollout(nthread=num_threads if num_threads > 1 else 0)
        steps, size = config.substeps, mujoco.mj_stateSize(model, STATE)
        self.state = np.zeros((num_envs, size))
        self.sensors = np.zeros((num_envs, self.start.layout.size))
        self.yaw = np.zeros((num_envs, 2))
        self.place = np.zeros((num_envs, 2))
        self._states = np.zeros((num_envs, steps, size))
        self._trace = np.zeros((num_envs, steps, self.start.layout.size))
        self._controls = np.zeros((num_envs, steps, model.nu))

    def reset(self, slot: int, episode: Episode) -> np.ndarray:
        """Start ``episode`` in a slot; return its sensors as a trace of one substep, [1, 1, n]."""
        model, data = self.models[slot], self._data[0]
        self.yaw[slot], self.place[slot] = episode.yaw, episode.place
        self.start.begin(model, data, episode)
        mujoco.mj_getState(model, data, self.state[slot], STATE)
        self.sensors[slot] = data.sensordata
        return data.sensordata.copy()[None, None]

    def step(
        self, controls: np.ndarray, active: np.ndarray | bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """Advance the environments by one control step.

        Args:
            controls: Actuator controls, held during the step, [B, nu].
            active: Which environments take the step, [B]; True for all.

        Returns:
            The sensors of every substep [B, substeps, n] (overwritten by the next call), and which
            environments diverged [B]. A diverged one keeps the state before the step.
        """
        self._controls[:] = controls[:, None]
        self._rollout.rollout(
            self.models, self._data, self.state, self._controls, control_spec=CONTROL,
            skip_checks=True, nstep=self.config.substeps,
            state=self._states, sensordata=self._trace,
        )  # fmt: skip
        last = self._states[:, -1]
        diverged = has_diverged(last, self.state[:, 0], self.models[0], self.config)
        diverged &= active
        stepped = active & ~diverged
        self.state[stepped] = last[stepped]
        self.sensors[stepped] = self._trace[stepped, -1]
        return self._trace, diverged

    def close(self) -> None:
        """End the threads."""
        self._rollout.close()
