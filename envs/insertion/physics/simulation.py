"""A batch of MuJoCo simulations stepped in C, without Python between substeps."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from mujoco import rollout

from ..config import InsertionConfig
from .start import Episode, StartState

STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS.value
CONTROL = mujoco.mjtState.mjSTATE_CTRL.value


def has_diverged(
    state: np.ndarray, start_time: np.ndarray, model: mujoco.MjModel, config: InsertionConfig
) -> np.ndarray:
    """Which full physics states [B, nstate] are not the end of a regular control step, [B] bool.

    They are not finite or impossibly fast, or MuJoCo found them bad on the way: it then resets the
    simulation (and ``rollout`` stops), which shows in the time elapsed since ``start_time`` [B].
    """
    velocity = state[:, 1 + model.nq : 1 + model.nq + model.nv]
    slow = np.abs(velocity).max(axis=1) <= config.velocity_limit  # False for NaN
    elapsed = state[:, 0] - start_time
    on_time = np.abs(elapsed - config.control_timestep) < 0.5 * config.physics_timestep
    return ~(slow & on_time & np.isfinite(state).all(axis=1))


class BatchSimulation:
    """B independent copies of one model, advanced by ``mujoco.rollout``.

    Every control step starts from the full physics state without warm start, so that a step depends on
    nothing but state and control: slots, threads and restored states cannot influence each other.

    Args:
        model: compiled task.
        config: the task's settings.
        num_envs: B.
        num_threads: 1 runs in the calling thread; more make a pool that lives as long as this object.

    Attributes:
        state: [B, nstate] full physics state: time, positions, velocities.
        sensors: [B, n] sensordata of the last substep.
        yaw: [B, 2] yaw of the left and right standing block at the last reset, rad.
        start: the nominal start of an episode.
    """

    def __init__(
        self, model: mujoco.MjModel, config: InsertionConfig, num_envs: int, num_threads: int
    ) -> None:
        self.config = config
        self.start = StartState(model, config)
        # Per-environment models exist only where an episode's yaw is part of the model.
        shared = not self.start.yaw_in_model
        self._models = [model if shared else copy.copy(model) for _ in range(num_envs)]
        self._data = [mujoco.MjData(model) for _ in range(num_threads)]
        self._rollout = rollout.Rollout(nthread=num_threads if num_threads > 1 else 0)
        steps, size = config.substeps, mujoco.mj_stateSize(model, STATE)
        self.state = np.zeros((num_envs, size))
        self.sensors = np.zeros((num_envs, self.start.layout.size))
        self.yaw = np.zeros((num_envs, 2))
        self._states = np.zeros((num_envs, steps, size))
        self._trace = np.zeros((num_envs, steps, self.start.layout.size))
        self._controls = np.zeros((num_envs, steps, model.nu))

    @property
    def model(self) -> mujoco.MjModel:
        """The model of the first environment."""
        return self._models[0]

    def slot_model(self, slot: int) -> mujoco.MjModel:
        """The model of one environment."""
        return self._models[slot]

    def reset(self, slot: int, episode: Episode) -> np.ndarray:
        """Starts ``episode`` in a slot; returns its sensors as a trace of one substep [1, n]."""
        model, data = self._models[slot], self._data[0]
        self.set_yaw(slot, episode.yaw)
        self.start.hold(model, data, self.start.qpos(model, episode))
        mujoco.mj_getState(model, data, self.state[slot], STATE)
        self.sensors[slot] = data.sensordata
        return data.sensordata.copy()[None]

    def set_yaw(self, slot: int, yaw: np.ndarray) -> None:
        """Sets the episode's yaw [2] of a slot."""
        self.yaw[slot] = yaw
        self.start.set_yaw(self._models[slot], yaw)

    def step(
        self, controls: np.ndarray, active: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Advances the environments by one control step.

        Args:
            controls: [B, nu], held during the step.
            active: [B] which environments take the step; ``None`` for all.

        Returns:
            The sensors of every substep [B, substeps, n] (overwritten by the next call), and which
            environments diverged [B]. A diverged one keeps the state before the step.
        """
        self._controls[:] = controls[:, None]
        self._rollout.rollout(
            self._models,
            self._data,
            self.state,
            self._controls,
            control_spec=CONTROL,
            skip_checks=True,
            nstep=self.config.substeps,
            state=self._states,
            sensordata=self._trace,
        )
        last = self._states[:, -1]
        diverged = has_diverged(last, self.state[:, 0], self.model, self.config)
        if active is not None:
            diverged &= active
        if active is not None or diverged.any():
            fine = ~diverged if active is None else active & ~diverged
            self.state[fine] = last[fine]
            self.sensors[fine] = self._trace[fine, -1]
        else:
            self.state[:] = last
            self.sensors[:] = self._trace[:, -1]
        return self._trace, diverged

    def close(self) -> None:
        """Ends the threads."""
        self._rollout.close()
