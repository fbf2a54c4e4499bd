"""Disturbance of the control output (paper, section VI-B; figure 3b and 3c)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import Composite, Unbounded

from rrl.checks import check_length, per_dimension
from rrl.keys import ACTION, EXECUTED_ACTION
from rrl.transforms.action import ActionTransform, sibling
from rrl.transforms.action_bounds import ActionLimits
from rrl.transforms.base import RandomTransform
from rrl.transforms.masks import merge, reset_mask, step_mask

__all__ = ["ControlNoise"]


class ControlNoise(ActionTransform, RandomTransform):
    r"""Adds bias and noise to the action that reaches the environment.

    This is the paper's :math:`u' = u + N(\mu, \sigma^2)`, drawn anew for every step and dimension,
    in half ranges of the action, and clipped to its bounds:

        u' = clip(u + half_range * (mu + sigma * z), low, high),  z ~ N(0, 1).

    In a list it stands before :class:`~rrl.transforms.ResidualAction`: actions run from last to
    first, so the sum is formed first and then disturbed, for every arm alike. What was executed is
    recorded with the step's outcome; at a reset the record is zero. With mu = sigma = 0 the action
    passes unchanged.

    policy -> env: reads and writes ``action_key``.
    env -> policy: writes ``executed_action_key``, ``[*batch, n_act]`` in the environment's units.

    Args:
        mu: Bias in half ranges of the action, a number or one a dimension.
        sigma: Standard deviation in half ranges, a number or one a dimension, not negative.
        seed: Seed of slot 0, slot i uses ``seed + i``. None: from torch's global generator at every
            reset of all slots. Workers of a ``ParallelEnv`` want None, or they all draw the same.
        executed_action_key: Default: "executed_action" at the level of ``action_key``.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If sigma is negative, a value is not finite, or lists do not have the action's
            length.
        TypeError: If the action is not continuous.
        KeyError: If the action is missing.
        RuntimeError: If actions pass the inverse without an environment, as in
            ``ReplayBuffer.extend``.

    """

    def __init__(
        self,
        mu: float | Sequence[float] = 0.0,
        sigma: float | Sequence[float] = 0.0,
        seed: int | None = None,
        executed_action_key: NestedKey | None = None,
        action_key: NestedKey = ACTION,
    ) -> None:
        action_key = unravel_key(action_key)
        executed_key = unravel_key(executed_action_key or sibling(action_key, EXECUTED_ACTION))
        super().__init__(
            seed=seed,
            stream=f"ControlNoise/{action_key}",
            out_keys=[executed_key],
            in_keys_inv=[action_key],
            out_keys_inv=[action_key],
        )
        self._action_key = action_key
        self._executed_key = executed_key
        self.mu = per_dimension("mu", mu)
        self.sigma = per_dimension("sigma", sigma, minimum=0.0)
        self._noisy = bool((self.sigma != 0).any())
        self._active = self._noisy or bool((self.mu != 0).any())
        self._scaled: tuple[Tensor, Tensor] | None = None
        self._executed: Tensor | None = None

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        limits = self._limits or self.limits()
        action = self.require(tensordict, self._action_key)
        if self._active:
            action = self._disturb(action, limits, tensordict)
            tensordict.set(self._action_key, action)
        return tensordict.set(self._executed_key, action)

    def _disturb(self, action: Tensor, limits: ActionLimits, tensordict: TensorDictBase) -> Tensor:
        bias, deviation = self._scaled or self._scale(limits)
        disturbed = action + bias
        if self._noisy:
            batch = tensordict.batch_size
            shape = action.shape[len(batch) :]
            noise = self.draw_normal(batch, shape, step_mask(tensordict, batch)).to(action)
            # Separate product and sums: fused ones round differently in different places of a
            # batch.
            disturbed = disturbed + noise * deviation
        return torch.clamp(disturbed, limits.low, limits.high)

    def _scale(self, limits: ActionLimits) -> tuple[Tensor, Tensor]:
        check_length("mu", self.mu, limits.shape[-1], "the action")
        check_length("sigma", self.sigma, limits.shape[-1], "the action")
        self._scaled = (
            self.mu.to(limits.half_range) * limits.half_range,
            self.sigma.to(limits.half_range) * limits.half_range,
        )
        return self._scaled

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self._executed = tensordict.get(self._executed_key)
        return next_tensordict.set(self._executed_key, self._executed)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        batch = tensordict_reset.batch_size
        mask = reset_mask(tensordict, batch)
        self.start_episodes(batch, mask)
        limits = self._limits or self.limits()
        executed = torch.zeros(limits.shape, dtype=limits.dtype, device=limits.low.device)
        if mask is not None and self._executed is not None:
            executed = merge(mask, executed, self._executed)
        self._executed = executed
        return tensordict_reset.set(self._executed_key, executed)

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # An environment that reset itself within a step is reset by mask like any other.
        return self._reset(tensordict, tensordict_reset)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Leave data outside an environment alone: there is no action on its way to anywhere."""
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the executed action, in the environment's action units."""
        if self._executed_key in observation_spec.keys(True, True):
            raise ValueError(
                f"The observations hold {self._executed_key!r} already. Pass another executed_action_key."
            )
        limits = self.limits()
        observation_spec[self._executed_key] = Unbounded(
            shape=limits.shape, device=limits.low.device, dtype=limits.dtype
        )
        return observation_spec

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Leave the action's spec as it is and remember its bounds."""
        self._take_limits(action_spec)
        return action_spec

    def _take_limits(self, action_spec: Any) -> ActionLimits:
        self._scaled = None
        return super()._take_limits(action_spec)
