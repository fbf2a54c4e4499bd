"""A bound on the size of an action and on its change from step to step."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check_length, per_dimension
from rrl.keys import ACTION
from rrl.transforms.base import ActionLimits, share_within
from rrl.transforms.safety.base import CommandLimit


class StepLimit(CommandLimit):
    """A bound on an action's size, and on its change since the last step.

        |u_t| <= size * half_range,  |u_t - u_{t-1}| <= change * half_range

    in every dimension. A command that is too large is clipped; of a change that is too large the
    first part is taken, on the straight line from the last action. So both hold at once, and so
    does every other limit of a convex set of actions that does not change, such as that of
    :class:`~rrl.transforms.ForceLimit`, if it holds for the command: this limit may stand before it
    and have the last word. A command that is not finite is replaced by the last executed one. What
    is guaranteed is about commands alone and takes no measurement.

    Before an episode's first step u is zero, the rest of displacements and velocities. With
    absolute targets that would be a jump towards zero: name in ``start_key`` what the robot holds.

    policy -> env: reads and writes ``action_key``.
    env -> policy: reads ``start_key``, writes ("safety", "step"); see :class:`SafetyLimit`.

    Args:
        size: In half ranges of the action, a number or one for each dimension, positive; None: no
            limit. For actions whose rest is zero; for absolute targets limit the change alone.
        change: In half ranges of the action, a number or one for each dimension, positive; None: no
            limit.
        start_key: Observation ``[*batch, n_act]`` of what the robot holds at a reset, in the
            action's units; zeros count where it is not finite. None: zeros.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If there is no limit, one is not positive and finite, or one or the start does
            not have the action's length.
        KeyError: If action or start is missing.
        RuntimeError: If actions pass the inverse without an environment or before a reset.
    """

    def __init__(
        self,
        size: float | Sequence[float] | None = None,
        change: float | Sequence[float] | None = None,
        action_key: NestedKey = ACTION,
        start_key: NestedKey | None = None,
    ) -> None:
        super().__init__("step", start_key, action_key)
        if size is None and change is None:
            raise ValueError("StepLimit: expected a size, a change or both, got neither")
        self.size = None if size is None else per_dimension("size", size, positive=True)
        self.change = None if change is None else per_dimension("change", change, positive=True)

    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Clip the size, then go as far from the last action as the change allows."""
        if self.size is not None:
            size = self.size.to(measured) * limits.half_range
            action = torch.clamp(action, -size, size)
        if self.change is None:
            return action
        change = self.change.to(measured) * limits.half_range
        wanted = action - measured
        share = share_within(wanted, change)
        return torch.where(share < 1.0, measured + share * wanted, action)

    def hold(self, tensordict: TensorDictBase, measured: Tensor) -> Tensor:
        """Return the last executed action, which keeps both limits."""
        return measured

    def check_sizes(self, sizes: dict[NestedKey, int], action_size: int) -> None:
        """Hold limits and start to the action's size."""
        super().check_sizes(sizes, action_size)
        for name, value in (("size", self.size), ("change", self.change)):
            if value is not None:
                check_length(name, value, action_size, "the action")
