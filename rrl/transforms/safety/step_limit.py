"""A bound on the size of an action and on its change from step to step."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check_length, per_dimension
from rrl.keys import ACTION
from rrl.transforms.base import ActionLimits
from rrl.transforms.safety.base import SafetyLimit

__all__ = ["StepLimit"]


class StepLimit(SafetyLimit):
    """A bound on an action's size, and on its change since the last step.

        |u_t| <= size * half_range,  |u_t - u_{t-1}| <= change * half_range,  u_{-1} = 0

    in every dimension. Where both cannot hold, the size does. A command that is not finite is
    replaced by the last executed one.

    policy -> env: reads and writes ``action_key``.
    env -> policy: writes ("safety", "step"); see :class:`SafetyLimit`.

    Args:
        size: In half ranges of the action, a number or one for each dimension, positive; None: no
            limit. For actions whose rest is zero, such as displacements; for absolute targets limit
            the change alone.
        change: In half ranges of the action, a number or one for each dimension, positive; None: no
            limit.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If there is no limit, one is not positive and finite, or one does not have the
            action's length.
        KeyError: If the action is missing.
        RuntimeError: If actions pass the inverse without an environment or before a reset.
    """

    def __init__(
        self,
        size: float | Sequence[float] | None = None,
        change: float | Sequence[float] | None = None,
        action_key: NestedKey = ACTION,
    ) -> None:
        super().__init__("step", [], action_key)
        if size is None and change is None:
            raise ValueError("StepLimit: expected a size, a change or both, got neither")
        self.size = None if size is None else per_dimension("size", size, positive=True)
        self.change = None if change is None else per_dimension("change", change, positive=True)

    def measure(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return the action that was executed."""
        return action

    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Clip change, then size."""
        if self.change is not None:
            change = self.change.to(measured) * limits.half_range
            action = torch.clamp(action, measured - change, measured + change)
        if self.size is not None:
            size = self.size.to(measured) * limits.half_range
            action = torch.clamp(action, -size, size)
        return action

    def hold(self, tensordict: TensorDictBase, measured: Tensor) -> Tensor:
        """Return the last executed action, which keeps both limits."""
        return measured

    def check_sizes(self, sizes: dict[NestedKey, int], action_size: int) -> None:
        """Hold the limits to the action's size."""
        for name, value in (("size", self.size), ("change", self.change)):
            if value is not None:
                check_length(name, value, action_size, "the action")
