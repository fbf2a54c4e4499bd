"""Noise and bias of a sensor, such as the camera tracker's."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from rrl.checks import check_length, per_dimension, require
from rrl.transforms.base import Mask, Memory
from rrl.transforms.sensing.fault import SensingFault


class ObservationNoise(SensingFault):
    """A constant bias and Gaussian noise on observations.

        o' = o + bias + sigma * z,  z ~ N(0, 1).

    Drawn once for each observation: what a step returns in "next" is what the next step sees.

    env -> policy: reads ``in_keys``, writes ``out_keys``.

    Args:
        in_keys: Observations ``[*batch, n]``; may be nested.
        sigma: Standard deviation in the observation's unit, a number or one for each element, not
            negative.
        bias: In the observation's unit, a number or one for each element.
        seed: Seed of slot 0, slot i uses ``seed + i``. None: from torch's global generator at every
            reset of all slots. Workers of a ``ParallelEnv`` need None, or they all draw the same.
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
        super().__init__(in_keys, out_keys, seed)
        self._set(sigma, bias)

    def _set(self, sigma: float | Sequence[float], bias: float | Sequence[float]) -> None:
        self.sigma = per_dimension("sigma", sigma, minimum=0.0)
        self.bias = per_dimension("bias", bias)
        self._noisy = bool((self.sigma != 0).any())

    def silence(self) -> None:
        """Take away bias and noise."""
        self._set(0.0, 0.0)

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        return self._observe(td, td.batch_size, mask)

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        return self._observe(next_td, next_td.batch_size, mask)

    def resets_itself(self) -> bool:
        """Return False: the first observation of an episode is as noisy as the others."""
        return False

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Add noise outside an environment; in a replay buffer it is drawn anew for each sample."""
        # One slot draws for all samples: batches of another size would start its numbers anew.
        disturbed = self._observe(tensordict, torch.Size(), None)
        for key, value in zip(self.out_keys, disturbed.values(), strict=True):
            tensordict.set(key, value)
        return tensordict

    def _observe(self, tensordict: TensorDictBase, slots: torch.Size, mask: Mask) -> Memory:
        seen = self._read(tensordict)
        for key, value in zip(self.in_keys, seen.values(), strict=True):
            self._check_lengths(key, value.shape[tensordict.batch_dims :])
        return {name: self._disturb(value, slots, mask) for name, value in seen.items()}

    def _disturb(self, value: Tensor, slots: torch.Size, mask: Mask) -> Tensor:
        disturbed = value + self.bias.to(value)
        if self._noisy:
            noise = self.generators.normal(slots, value.shape[len(slots) :], mask).to(value)
            # Separate product and sums: fused ones round differently in different places of a
            # batch.
            disturbed = disturbed + noise * self.sigma.to(value)
        return disturbed.reshape(value.shape)

    def _check_lengths(self, key: NestedKey, shape: torch.Size) -> None:
        for name, value in (("sigma", self.sigma), ("bias", self.bias)):
            check_length(name, value, shape[-1:].numel(), f"the observation {key!r}")

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Write the noisy observations' specs, which have no bounds.

        Raises:
            TypeError: If an observation is of whole numbers or flags.
        """
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            spec = require(self, observation_spec, in_key)
            self._check_lengths(in_key, spec.shape[observation_spec.ndim :])
            if not spec.dtype.is_floating_point:
                raise TypeError(
                    f"{in_key!r}: expected a floating point observation, got {spec.dtype}"
                )
            observation_spec[out_key] = Unbounded(spec.shape, device=spec.device, dtype=spec.dtype)
        return observation_spec
