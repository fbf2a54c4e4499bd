"""Noise and bias of a sensor, such as the camera tracker's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from rrl.checks import check_length, per_dimension
from rrl.transforms.action_bounds import unbounded_like
from rrl.transforms.base import RandomTransform
from rrl.transforms.masks import merge, reset_mask, step_mask

__all__ = ["ObservationNoise"]


class ObservationNoise(RandomTransform):
    """Adds a constant bias and Gaussian noise to observations.

        o' = o + bias + sigma * z,  z ~ N(0, 1).

    Drawn once for each observation: what a step returns in "next" is what the next step sees.

    env -> policy: reads ``in_keys``, writes ``out_keys``.

    Args:
        in_keys: Observations ``[*batch, n]``; may be nested.
        sigma: Standard deviation in the observation's unit, a number or one an element, not
            negative.
        bias: In the observation's unit, a number or one an element.
        seed: Seed of slot 0, slot i uses ``seed + i``. None: from torch's global generator at every
            reset of all slots. Workers of a ``ParallelEnv`` want None, or they all draw the same.
        out_keys: Where the noisy observations go; default: ``in_keys``.

    Raises:
        ValueError: If sigma is negative, a value is not finite, keys are none or differ in number,
            or a list does not have the observation's length.
        TypeError: If an observation is not floating point.
        KeyError: If an observation is missing.

    """

    def __init__(
        self,
        in_keys: Sequence[NestedKey],
        sigma: float | Sequence[float] = 0.0,
        bias: float | Sequence[float] = 0.0,
        seed: int | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        super().__init__(
            seed=seed,
            stream=f"ObservationNoise/{in_keys}",
            in_keys=in_keys,
            out_keys=in_keys if out_keys is None else out_keys,
        )
        self.check_key_pairs()
        self.sigma = per_dimension("sigma", sigma, minimum=0.0)
        self.bias = per_dimension("bias", bias)
        self._noisy = bool((self.sigma != 0).any())
        self._last: list[Tensor] | None = None

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        batch = tensordict_reset.batch_size
        mask = reset_mask(tensordict, batch)
        self.start_episodes(batch, mask)
        for key in self.in_keys:
            self._check_lengths(key, self.require(tensordict_reset, key).shape)
        return self._observe(tensordict_reset, mask)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        mask = step_mask(tensordict, next_tensordict.batch_size)
        return self._observe(next_tensordict, mask)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._observe(next_tensordict, None)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Add noise outside an environment; in a replay buffer it is drawn anew for each sample."""
        self._last = None
        return self._observe(tensordict, None)

    def _observe(self, tensordict: TensorDictBase, mask: Tensor | None) -> TensorDictBase:
        last = self._last
        current = []
        for number, (in_key, out_key) in enumerate(zip(self.in_keys, self.out_keys, strict=True)):
            value = self._disturb(self.require(tensordict, in_key), tensordict.batch_size, mask)
            if mask is not None and last is not None:
                value = merge(mask, value, last[number])
            current.append(value)
            tensordict.set(out_key, value)
        self._last = current
        return tensordict

    def _disturb(self, value: Tensor, batch: torch.Size, mask: Tensor | None) -> Tensor:
        if self.bias.dtype != value.dtype or self.bias.device != value.device:
            self.bias, self.sigma = self.bias.to(value), self.sigma.to(value)
        disturbed = value + self.bias
        if self._noisy:
            noise = self.draw_normal(batch, value.shape[len(batch) :], mask).to(value)
            # Separate product and sums: fused ones round differently in different places of a
            # batch.
            disturbed = disturbed + noise * self.sigma
        return disturbed

    def _check_lengths(self, key: NestedKey, shape: torch.Size) -> None:
        size = shape[-1] if shape else 1
        check_length("sigma", self.sigma, size, f"the observation {key!r}")
        check_length("bias", self.bias, size, f"the observation {key!r}")

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Write the noisy observations' specs, which have no bounds."""
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            spec = self.require_spec(observation_spec, in_key)
            self._check_lengths(in_key, spec.shape)
            observation_spec[out_key] = unbounded_like(spec)
        return observation_spec

    def get_extra_state(self) -> dict[str, Any]:
        """Return generators and last observations for ``state_dict``."""
        return {**super().get_extra_state(), "last": self._last}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take generators and last observations from a ``state_dict``."""
        super().set_extra_state(state)
        self._last = state["last"]
