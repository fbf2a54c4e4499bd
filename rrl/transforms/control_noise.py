"""Disturbance of the control output (paper, section VI-B; figure 3b and 3c)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import Composite

from rrl.checks import check_length, per_dimension
from rrl.keys import ACTION, EXECUTED_ACTION
from rrl.slot_masks import step_mask
from rrl.transforms.base import (
    ActionLimits,
    ActionTransform,
    Mask,
    Memory,
    RandomTransform,
    sibling,
)


class ControlNoise(ActionTransform, RandomTransform):
    r"""Bias and noise on the action that reaches the environment.

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
        mu: Bias in half ranges of the action, a number or one for each dimension.
        sigma: Standard deviation in half ranges, a number or one for each dimension, not negative.
        seed: Seed of slot 0, slot i uses ``seed + i``. None: from torch's global generator at every
            reset of all slots. Workers of a ``ParallelEnv`` need None, or they all draw the same.
        executed_action_key: Default: "executed_action" at the level of ``action_key``.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If sigma is negative, a value is not finite, or a list does not have the
            action's length.
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
        usual_key = sibling(action_key, EXECUTED_ACTION)
        executed_key = unravel_key(executed_action_key or usual_key)
        beside = "" if executed_key == usual_key else f"/{executed_key}"
        super().__init__(
            action_key=action_key,
            seed=seed,
            stream=f"ControlNoise/{unravel_key(action_key)}{beside}",
            out_keys=[executed_key],
        )
        self._executed_key = executed_key
        self._set(mu, sigma)

    def _set(self, mu: float | Sequence[float], sigma: float | Sequence[float]) -> None:
        self.mu = per_dimension("mu", mu)
        self.sigma = per_dimension("sigma", sigma, minimum=0.0)
        self._noisy = bool((self.sigma != 0).any())
        self._active = self._noisy or bool((self.mu != 0).any())

    def silence(self) -> None:
        """Take away bias and noise; what was executed is still recorded."""
        self._set(0.0, 0.0)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        limits = self.limits()
        action = self.action(tensordict)
        if self._active:
            action = self._disturb(action, limits, tensordict)
        return self.give(tensordict, action)

    def _disturb(self, action: Tensor, limits: ActionLimits, tensordict: TensorDictBase) -> Tensor:
        disturbed = action + self._bias
        if self._noisy:
            batch = tensordict.batch_size
            shape = action.shape[len(batch) :]
            noise = self.generators.normal(batch, shape, step_mask(tensordict, batch)).to(action)
            # Separate product and sums: fused ones round differently in different places of a
            # batch.
            disturbed = disturbed + noise * self._deviation
        return torch.clamp(disturbed, limits.low, limits.high)

    def _take_limits(self, action_spec: Composite) -> ActionLimits:
        limits = super()._take_limits(action_spec)
        for name, value in (("mu", self.mu), ("sigma", self.sigma)):
            check_length(name, value, limits.shape[-1], "the action")
        unit = limits.half_range
        self._bias, self._deviation = self.mu.to(unit) * unit, self.sigma.to(unit) * unit
        return limits

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        return {"executed": self.nothing(td)}

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        return {"executed": self.executed(td)}

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the executed action, in the environment's action units."""
        return self.add_spec(
            observation_spec, self._executed_key, self.action_like(), "executed_action_key"
        )
