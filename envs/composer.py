"""Any dm_control composer environment as a TorchRL environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from dm_control import composer
from torchrl.data import Binary, Composite, TensorSpec
from torchrl.envs import DMControlWrapper

from rrl.keys import REWARD_TERMS


class ComposerEnv(DMControlWrapper):
    """A :class:`dm_control.composer.Environment` with ``batch_size []``, in float32.

    Reads ``action``; writes the environment's observables under their own names, ``reward`` [1],
    ``done``, ``terminated`` and ``truncated`` [1]. An episode that ends with discount 1, at the time
    limit for instance, is truncated. Our own task's keys are those of
    :class:`~rrl.envs.InsertionEnv`, with ``("reward_terms", name)`` nested.

    Args:
        env: a composer environment, for instance ``rrl.envs.load("insertion-real")`` or
            ``dm_control.manipulation.load(...)``. A pixel observable stays uint8.
        seed: of the environment's ``random_state``; ``None`` leaves it as it is.

    Raises:
        TypeError: ``env`` is no composer environment.
    """

    def __init__(self, env: composer.Environment, seed: int | None = None) -> None:
        super().__init__(env=env)
        if seed is not None:
            self.set_seed(seed)

    def _check_kwargs(self, kwargs: dict[str, Any]) -> None:
        env = kwargs.get("env")
        if not isinstance(env, composer.Environment):
            raise TypeError(
                "ComposerEnv needs a dm_control.composer.Environment, for instance "
                f"rrl.envs.load('insertion-real'), got {type(env).__name__}; use torchrl's "
                "DMControlWrapper for the control suite"
            )

    def _make_specs(self, env: composer.Environment) -> None:
        super()._make_specs(env)
        observation = Composite()
        for name, spec in self.full_observation_spec.items():
            observation[_key(name)] = _cast(spec)
        self.observation_spec = observation
        self.reward_spec = _cast(self.full_reward_spec["reward"])
        self.action_spec = _cast(self.full_action_spec["action"])

    def _set_seed(self, seed: int | None) -> None:
        if seed is not None:
            self._env.random_state.seed(seed)

    def read_obs(self, observations: dict[str, Any]) -> dict[str, Any]:
        """Observables as tensors of the specs' type and shape; ``reward_terms/`` nested."""
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
    """Our own reward terms are nested; other names keep their slashes."""
    group, _, item = name.partition("/")
    return (group, item) if group == REWARD_TERMS and item else name


def _cast(spec: TensorSpec) -> TensorSpec:
    """float64 becomes float32, bool a flag; everything else stays."""
    if spec.dtype == torch.float64:
        return spec.to(torch.float32)
    if spec.dtype == torch.bool:
        return Binary(n=spec.shape[-1], shape=spec.shape, dtype=torch.bool)
    return spec
