"""The batched TorchRL environment of the block-insertion task."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from rrl.threads import available_threads

from . import quantities
from .config import InsertionConfig, make_config
from .model.scene import compile_model
from .physics.control import check_action, set_points
from .physics.simulation import BatchSimulation
from .physics.start import draw_episode
from .quantities import Measurement

ENVS_PER_THREAD = 8
"""Fewer are not worth a thread."""


class InsertionEnv(EnvBase):
    """Block insertion, ``batch_size [num_envs]``, on :mod:`mujoco.rollout`.

    Reads ``action`` [3] in [-1, 1]: displacement of the set point (x, y, z) in units of ``action_scale``;
    values outside are clipped. Writes, float32 unless stated:

    ==========================  ==========================================================
    ``end_effector_position``   [3] m
    ``wrench`` or ``force_z``   [6] N and N m (``sim``), or [1] N (``real``)
    ``blocks``                  [13] position m, tilt and yaw rad of the left, then the right
                                standing block; position of the held block, m
    ``goal``                    [3] m
    ``success``                 [1] bool, of this very state
    ``contact_force``           [1] N, largest within the control step
    ``tilt``                    [1] rad, larger inclination of the two standing blocks
    ``diverged``                [1] bool, physics failed in this step
    ``("reward_terms", name)``  [1] each weighted term
    ``reward``                  [1] their sum
    ``done`` and its two parts  [1] bool; the time limit and diverged physics are ``truncated``
    ==========================  ==========================================================

    When physics diverges the episode ends as truncated, with the last finite observation and reward,
    ``diverged`` is set and :attr:`num_diverged` counts it; the next reset recovers that slot.

    Slots are independent: each has its own generator, slot i seeded ``seed + i``, and equals bit for
    bit a batch of one seeded ``seed + i``.

    Args:
        variant: ``sim`` or ``real``, or a whole :class:`~rrl.envs.InsertionConfig`.
        num_envs: batch size, 1 or more.
        num_threads: threads for physics; the results do not depend on it. ``None``: one a core
            (``OMP_NUM_THREADS`` if it is set), for at least eight environments each.
        seed: of the first slot. ``None`` draws one from torch's global generator.
        overrides: fields of :class:`~rrl.envs.InsertionConfig` to replace.

    Raises:
        ValueError: unknown variant or setting, values that do not fit together, sizes below 1.
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
        super().__init__(device="cpu", batch_size=[num_envs])
        self.config = make_config(variant, overrides)
        self.num_envs = num_envs
        self.num_diverged = 0
        threads = num_threads or max(1, min(available_threads(), num_envs // ENVS_PER_THREAD))
        self._simulation = BatchSimulation(
            compile_model(self.config), self.config, num_envs, threads
        )
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._measurement = _empty_measurement(num_envs)
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
        """Finds what is wrong with arguments of the constructor without building physics.

        Returns:
            The size of each observation entry.

        Raises:
            ValueError: what the constructor would raise.
        """
        for name, value in (
            ("num_envs", num_envs),
            ("num_threads", 1 if num_threads is None else num_threads),
        ):
            if not isinstance(value, int) or isinstance(value, bool) or value < 1:
                raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")
        if seed is not None and (not isinstance(seed, int) or seed < 0):
            raise ValueError(f"seed must be a whole number of at least 0, or None, got {seed!r}")
        return quantities.observation_sizes(make_config(variant, overrides))

    # ---------------------------------------------------------------- specs

    def _make_specs(self) -> None:
        batch = self.num_envs

        def real(size: int) -> Unbounded:
            return Unbounded((batch, size), dtype=torch.float32)

        def flag() -> Binary:
            return Binary(n=1, shape=(batch, 1), dtype=torch.bool)

        sizes = quantities.observation_sizes(self.config)
        terms = {name: real(1) for name in quantities.reward_term_names(self.config)}
        self.observation_spec = Composite(
            **{name: real(size) for name, size in sizes.items()},
            success=flag(),
            diverged=flag(),
            contact_force=real(1),
            tilt=real(1),
            reward_terms=Composite(terms, shape=(batch,)),
            shape=(batch,),
        )
        self.action_spec = Bounded(-1.0, 1.0, shape=(batch, 3), dtype=torch.float32)
        self.reward_spec = real(1)
        self.done_spec = Composite(done=flag(), terminated=flag(), truncated=flag(), shape=(batch,))

    # ---------------------------------------------------------------- randomness

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            seed = int(torch.randint(2**31, ()).item())
        self._generators = [np.random.default_rng(seed + i) for i in range(self.num_envs)]

    # ---------------------------------------------------------------- reset and step

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        mask = None if tensordict is None else tensordict.get("_reset", None)
        slots = np.arange(self.num_envs)
        if mask is not None:
            slots = np.flatnonzero(mask.reshape(self.num_envs).numpy())
        simulation = self._simulation
        for slot in slots.tolist():
            episode = draw_episode(self.config, self._generators[slot])
            trace = simulation.reset(slot, episode)[None]
            self._measure(trace, slice(slot, slot + 1))
            self._steps[slot] = 0
        nothing = np.zeros(self.num_envs, dtype=bool)
        return self._output(diverged=nothing, truncated=None)

    def _measure(self, trace: np.ndarray, where: Any) -> None:
        """Measures ``trace`` [b, substeps, n] of the slots ``where``."""
        views = self._simulation.start.layout.views(trace)
        fresh = quantities.measure(views, self._simulation.start.tare)
        for old, new in zip(self._measurement, fresh, strict=True):
            old[where] = new

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"].detach().numpy().astype(np.float64)
        action = check_action(action, self.num_envs)
        active = self._active(tensordict)
        simulation = self._simulation
        signals = simulation.start.layout.views(simulation.sensors)
        controls = set_points(signals, action, self.config, simulation.start.home)
        trace, diverged = simulation.step(controls, active)
        if active is None and not diverged.any():
            self._measure(trace, slice(None))
            self._steps += 1
        else:
            stepped = np.ones(self.num_envs, dtype=bool) if active is None else active
            self.num_diverged += int(diverged.sum())
            self._measure(trace[stepped & ~diverged], stepped & ~diverged)
            self._steps += stepped
        return self._output(diverged, (self._steps >= self.config.episode_length) | diverged)

    def _active(self, tensordict: TensorDictBase) -> np.ndarray | None:
        """Slots that take this step, from TorchRL's ``_step`` mask; ``None`` for all."""
        mask = tensordict.get("_step", None)
        if mask is None or bool(mask.all()):
            return None
        return mask.reshape(self.num_envs).numpy()

    def _output(self, diverged: np.ndarray, truncated: np.ndarray | None) -> TensorDictBase:
        """Everything that is written; with reward and done where ``truncated`` is given."""
        m, config = self._measurement, self.config
        terms = quantities.reward_terms(m, config)
        entries: dict[str, Any] = {
            name: _tensor(value) for name, value in quantities.observation(m, config).items()
        }
        entries["success"] = torch.from_numpy(quantities.success(m, config)[:, None])
        entries["diverged"] = torch.from_numpy(diverged[:, None])
        entries["contact_force"] = _tensor(m.contact_force[:, None])
        entries["tilt"] = _tensor(m.inclination.max(axis=1)[:, None])
        entries["reward_terms"] = self._pack(
            {name: _tensor(value[:, None]) for name, value in terms.items()}
        )
        terminated = np.zeros((self.num_envs, 1), dtype=bool)
        done = terminated.copy() if truncated is None else truncated[:, None]
        entries["terminated"] = torch.from_numpy(terminated)
        entries["truncated"] = torch.from_numpy(done)
        entries["done"] = torch.from_numpy(done.copy())
        if truncated is not None:
            entries["reward"] = _tensor(quantities.total(terms)[:, None])
        return self._pack(entries)

    def _pack(self, entries: dict[str, Any]) -> TensorDict:
        # The entries are right by construction; checking each would cost as much as the physics.
        return TensorDict._new_unsafe(entries, batch_size=self.batch_size, device=self.device)

    # ---------------------------------------------------------------- state

    def physics_state(self) -> np.ndarray:
        """Full physics states [num_envs, nstate]: time, positions, velocities. A copy."""
        return self._simulation.state.copy()

    def slot_model(self, slot: int) -> mujoco.MjModel:
        """The MuJoCo model of one slot, for rendering its physics states."""
        return self._simulation.slot_model(slot)

    def get_extra_state(self) -> dict[str, Any]:
        """Everything that a run needs to go on in the middle of an episode, bit for bit.

        Part of ``state_dict()``: physics, step counters, last measurement and random generators.
        """
        simulation = self._simulation
        return {
            "physics": torch.from_numpy(simulation.state.copy()),
            "sensors": torch.from_numpy(simulation.sensors.copy()),
            "yaw": torch.from_numpy(simulation.yaw.copy()),
            "steps": torch.from_numpy(self._steps.copy()),
            "measurement": {
                name: torch.from_numpy(value.copy())
                for name, value in self._measurement._asdict().items()
            },
            "generators": [generator.bit_generator.state for generator in self._generators],
            "num_diverged": self.num_diverged,
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`get_extra_state` gave.

        Raises:
            ValueError: a state of another number of environments or another variant.
        """
        simulation = self._simulation
        if tuple(state["physics"].shape) != simulation.state.shape:
            raise ValueError(
                f"the saved state has physics of shape {tuple(state['physics'].shape)} "
                f"(environments, state), this environment {simulation.state.shape}: make the "
                "environment with the same variant and num_envs"
            )
        simulation.state[:] = state["physics"].numpy()
        simulation.sensors[:] = state["sensors"].numpy()
        for slot, yaw in enumerate(state["yaw"].numpy()):
            simulation.set_yaw(slot, yaw)
        self._steps[:] = state["steps"].numpy()
        for name, value in self._measurement._asdict().items():
            value[:] = state["measurement"][name].numpy()
        for generator, saved in zip(self._generators, state["generators"], strict=True):
            generator.bit_generator.state = saved
        self.num_diverged = int(state["num_diverged"])

    def close(self, **kwargs: Any) -> None:
        """Ends the physics threads."""
        self._simulation.close()
        super().close(**kwargs)


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(array.astype(np.float32))


def _empty_measurement(num_envs: int) -> Measurement:
    def zeros(*shape: int) -> np.ndarray:
        return np.zeros((num_envs, *shape))

    return Measurement(
        zeros(3), zeros(3), zeros(2, 3), zeros(2), zeros(2), zeros(2), zeros(6), zeros()
    )
