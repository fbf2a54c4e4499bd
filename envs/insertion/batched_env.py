"""The batched TorchRL environment of the block-insertion task."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from rrl.checks import check_whole
from rrl.keys import ACTION, DIVERGED, REWARD
from rrl.threads import available_threads

from . import quantities
from .config import InsertionConfig, make_config
from .physics.control import check_action
from .physics.simulation import BatchSimulation
from .physics.start import draw_episode

ENVS_PER_THREAD = 8
"""Fewer are not worth a thread."""


class InsertionEnv(EnvBase):
    """Block insertion, ``batch_size [num_envs]``, on :mod:`mujoco.rollout`.

    Reads ``action`` [3] in [-1, 1]: displacement of the set point (x, y, z) in units of
    ``action_scale``; values outside are clipped. Writes, float32 unless stated:

    ============================  ==========================================================
    ``end_effector_position``     [3] m
    ``wrench`` or ``force_z``     [6] N and N m (``sim``), or [1] N (``real``)
    ``blocks``                    [13] position m, tilt and yaw rad of the left, then the right
                                  standing block; position of the held block, m
    ``goal``                      [3] m
    ``success``                   [1] bool, of this very state
    ``diverged``                  [1] bool, physics failed in this step
    ``("metrics", name)``         [1] ``contact_force``, largest in the control step, N;
                                  ``tilt``, larger inclination of the standing blocks, rad
    ``("reward_terms", name)``    [1] each weighted term
    ``reward``                    [1] their sum
    ``done`` and its two parts    [1] bool; time limit and diverged physics are ``truncated``
    ============================  ==========================================================

    When physics diverges the episode ends as truncated, with the last finite observation and
    reward, and ``diverged`` is set; a reset recovers the slot.

    Slots are independent: each has its own generator, slot i seeded ``seed + i``, and equals bit
    for bit a batch of one seeded ``seed + i``.

    Args:
        variant: ``sim`` or ``real``, or a whole :class:`~rrl.envs.InsertionConfig`.
        num_envs: Batch size, 1 or more.
        num_threads: Threads for physics; the results do not depend on it. ``None``: one a core
            (``OMP_NUM_THREADS`` if it is set), for at least eight environments each.
        seed: Seed of the first slot. ``None`` draws one from torch's global generator.
        overrides: Fields of :class:`~rrl.envs.InsertionConfig` to replace.

    Raises:
        ValueError: If a name is unknown, a number is out of range, or values do not fit together.
    """

    makes_new_tensors = True
    """Whether what a step or reset gives is changed by nothing that comes later.

    A class derived from this one that shows a buffer of its own says False.
    """

    def __init__(
        self,
        variant: str | InsertionConfig = "sim",
        num_envs: int = 1,
        num_threads: int | None = None,
        seed: int | None = 0,
        **overrides: Any,
    ) -> None:
        self.check_arguments(variant, num_envs, num_threads, seed, **overrides)
        num_envs = int(num_envs)
        super().__init__(device="cpu", batch_size=[num_envs])
        self.config = make_config(variant, overrides)
        self.num_envs = num_envs
        threads = int(num_threads or 0) or max(
            1, min(available_threads(), num_envs // ENVS_PER_THREAD)
        )
        self._simulation = BatchSimulation(self.config, num_envs, threads)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        # What the last step wrote: slots that do not step, or diverge, write it again.
        blank = np.zeros((num_envs, 1, self._simulation.start.layout.size))
        self._outputs = {name: value.copy() for name, value in self._evaluate(blank).items()}
        self._generators: list[np.random.Generator] = []
        self._make_specs()
        self._set_seed(seed)

    @staticmethod
    def check_arguments(
        variant: str | InsertionConfig = "sim",
        num_envs: int = 1,
        num_threads: int | None = None,
        seed: int | None = 0,
        **overrides: Any,
    ) -> dict[str, int]:
        """Check the constructor's arguments without building physics.

        Returns:
            The size of each observation entry.

        Raises:
            ValueError: If the constructor would raise it.
        """
        check_whole("num_envs", num_envs, 1)
        check_whole("num_threads", 1 if num_threads is None else num_threads, 1)
        check_whole("seed", 0 if seed is None else seed, 0)
        config = make_config(variant, overrides)
        quantities.reward_weights(config)
        return quantities.observation_sizes(config)

    def _make_specs(self) -> None:
        batch = self.num_envs

        def flag() -> Binary:
            return Binary(n=1, shape=(batch, 1), dtype=torch.bool)

        observation = Composite({DIVERGED: flag()}, shape=(batch,))
        for name in quantities.output_names(self.config):
            value = self._outputs[name]
            real = Unbounded(value.shape, dtype=torch.float32)
            observation[tuple(name.split("/"))] = flag() if value.dtype == bool else real
        self.observation_spec = observation
        self.action_spec = Bounded(-1.0, 1.0, shape=(batch, 3), dtype=torch.float32)
        self.reward_spec = Unbounded((batch, 1), dtype=torch.float32)
        self.done_spec = Composite(done=flag(), terminated=flag(), truncated=flag(), shape=(batch,))

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            seed = int(torch.randint(2**31, ()).item())
        self._generators = [np.random.default_rng(int(seed) + i) for i in range(self.num_envs)]

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        every = np.ones(self.num_envs, dtype=bool)
        drawn = every if mask is None else mask.reshape(self.num_envs).numpy()
        for slot in np.flatnonzero(drawn).tolist():
            episode = draw_episode(self.config, self._generators[slot])
            self._keep(self._simulation.reset(slot, episode), slice(slot, slot + 1))
            self._steps[slot] = 0
        nothing = np.zeros(self.num_envs, dtype=bool)
        return self._pack(diverged=nothing, truncated=nothing).exclude(REWARD)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict[ACTION].detach().double().numpy()
        mask = tensordict.get("_step", None)  # slots that take this step; None: all
        every = np.ones(self.num_envs, dtype=bool)
        active = every if mask is None else mask.reshape(self.num_envs).numpy()
        if mask is not None:
            action = np.where(active[:, None], action, 0.0)  # nobody has chosen the others
        action = check_action(action, self.num_envs)
        controls = self._simulation.start.controls(self._simulation.sensors, action)
        trace, diverged = self._simulation.step(controls, active)
        self._steps += active
        fine = active & ~diverged
        where = slice(None) if fine.all() else fine  # a slice copies nothing
        self._keep(trace[where], where)
        return self._pack(diverged, (self._steps >= self.config.episode_length) | diverged)

    def _evaluate(self, trace: np.ndarray) -> dict[str, np.ndarray]:
        start = self._simulation.start
        return quantities.evaluate(start.layout.views(trace), start.tare, self.config)

    def _keep(self, trace: np.ndarray, where: slice | np.ndarray) -> None:
        """Evaluate the ``trace`` [b, substeps, n] of the slots ``where``."""
        for name, value in self._evaluate(trace).items():
            self._outputs[name][where] = value

    def _pack(self, diverged: np.ndarray, truncated: np.ndarray) -> TensorDict:
        """Return everything that a step writes, from the outputs and two flags [num_envs]."""
        outputs = {
            **self._outputs,
            DIVERGED: diverged[:, None],
            "truncated": truncated[:, None],
            "done": truncated[:, None],
            "terminated": np.zeros((self.num_envs, 1), dtype=bool),
        }
        entries: dict[str, Any] = {}
        groups: dict[str, dict[str, torch.Tensor]] = {}
        for name, value in outputs.items():
            tensor = torch.from_numpy(value.astype(bool if value.dtype == bool else np.float32))
            group, _, item = name.partition("/")
            (groups.setdefault(group, {}) if item else entries)[item or name] = tensor
        options: dict[str, Any] = {"batch_size": self.batch_size, "device": self.device}
        for group, items in groups.items():
            entries[group] = TensorDict(items, **options)
        return TensorDict(entries, **options)

    @property
    def control_period(self) -> float:
        """Seconds from one action to the next."""
        return self.config.control_timestep

    def physics_state(self) -> np.ndarray:
        """Return a copy of the physics states [num_envs, nstate]: time, positions, velocities."""
        return self._simulation.state.copy()

    def slot_model(self, slot: int) -> mujoco.MjModel:
        """Return the MuJoCo model of one slot, for rendering its physics states."""
        return self._simulation.models[slot]

    def get_extra_state(self) -> dict[str, Any]:
        """Return what ``state_dict()`` needs to go on in the middle of an episode, bit for bit."""
        arrays = {name: torch.from_numpy(value.copy()) for name, value in self._arrays().items()}
        generators = [generator.bit_generator.state for generator in self._generators]
        return {**arrays, "generators": generators}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what :meth:`get_extra_state` returned.

        Raises:
            ValueError: If the state is of another number of environments, another variant or other
                reward terms.
        """
        simulation = self._simulation
        for name, value in self._arrays().items():
            shape = tuple(state[name].shape) if name in state else None
            if shape != value.shape:
                raise ValueError(
                    f"state: expected {name} of shape {value.shape}, got {shape}; use the same "
                    "variant, num_envs and reward_weights"
                )
        for name, value in self._arrays().items():
            value[:] = state[name].numpy()
        for model, yaw, place in zip(
            simulation.models, simulation.yaw, simulation.place, strict=True
        ):
            simulation.start.set_blocks(model, yaw, place)
        for generator, saved in zip(self._generators, state["generators"], strict=True):
            generator.bit_generator.state = saved

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays, by name, that hold the environment's state."""
        simulation = self._simulation
        return {
            "physics": simulation.state,
            "sensors": simulation.sensors,
            "yaw": simulation.yaw,
            "place": simulation.place,
            "steps": self._steps,
            **{f"outputs/{name}": value for name, value in self._outputs.items()},
        }

    def close(self, **kwargs: Any) -> None:
        """End the physics threads."""
        self._simulation.close()
        super().close(**kwargs)
