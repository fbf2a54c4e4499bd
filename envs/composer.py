"""Any dm_control composer environment as a TorchRL environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from dm_control import composer
from numpy.typing import NDArray
from torchrl.data import Binary, Composite, TensorSpec
from torchrl.envs import DMControlWrapper

from rrl.keys import METRICS, REWARD_TERMS

from .pictures import mujoco_state


class ComposerEnv(DMControlWrapper):
    """A :class:`dm_control.composer.Environment` with ``batch_size []``.

    Reads ``action``; writes the environment's observables under their own names (those of the
    groups ``metrics/`` and ``reward_terms/`` nested), ``reward`` [1], ``done``, ``terminated`` and
    ``truncated`` [1]. An episode that ends with discount 1, at the time limit for instance, is
    truncated. Our own task's keys are those of :class:`~rrl.envs.InsertionEnv`.

    Args:
        env: A composer environment, for instance ``rrl.envs.load("insertion-real")`` or
            ``dm_control.manipulation.load(...)``. A pixel observable stays uint8.
        seed: Seed of the environment's ``random_state``; ``None`` leaves it as it is.
        dtype: Type of what dm_control gives in float64, the action included.

    Raises:
        TypeError: If ``env`` is no composer environment.
    """

    def __init__(
        self, env: composer.Environment, seed: int | None = None, dtype: torch.dtype = torch.float32
    ) -> None:
        self._dtype = dtype
        super().__init__(env=env)
        if seed is not None:
            self.set_seed(seed)

    def physics_state(self) -> NDArray[np.float64]:
        """Return the physics state, for :func:`~rrl.envs.render_mujoco`."""
        return mujoco_state(self)

    def _check_kwargs(self, kwargs: dict[str, Any]) -> None:
        env = kwargs.get("env")
        if not isinstance(env, composer.Environment):
            raise TypeError(
                "env: expected a dm_control.composer.Environment, for instance "
                f"rrl.envs.load('insertion-real'), got {type(env).__name__}; use torchrl's "
                "DMControlWrapper for the control suite"
            )

    def _make_specs(self, env: composer.Environment) -> None:
        super()._make_specs(env)
        observation = Composite()
        for name, spec in self.full_observation_spec.items():
            observation[_key(name)] = self._cast(spec)
        self.observation_spec = observation
        self.reward_spec = self._cast(self.full_reward_spec["reward"])
        self.action_spec = self._cast(self.full_action_spec["action"])

    def _cast(self, spec: TensorSpec) -> TensorSpec:
        """Return the spec with ``dtype`` for float64 and a flag for bool; others stay."""
        if spec.dtype == torch.float64:
            return spec.to(self._dtype)
        if spec.dtype == torch.bool:
            return Binary(n=spec.shape[-1], shape=spec.shape, dtype=torch.bool)
        return spec

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self.random_state.seed(seed)

    def read_obs(self, observations: dict[str, Any]) -> dict[str, Any]:
        """Return the observables as tensors of the specs' type and shape."""
        result: dict[str, Any] = {}
        for name, value in observations.items():
            key = _key(name)
            spec = self.observation_spec[key]
            tensor = torch.as_tensor(np.array(value), dtype=spec.dtype).reshape(spec.shape)
            if isinstance(key, tuple):
                result.setdefault(key[0], {})[key[1]] = tensor
            else:
                result[key] = tensor
        return result


def _key(name: str) -> str | tuple[str, str]:
    """Return the key of an observable: our own groups are nested, other names keep their slash."""
    group, _, item = name.partition("/")
    return (group, item) if group in (METRICS, REWARD_TERMS) and item else name
