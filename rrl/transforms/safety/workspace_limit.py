"""A box that the end effector is not commanded out of."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from rrl.checks import check_length, per_dimension
from rrl.keys import ACTION
from rrl.transforms.action_bounds import ActionLimits
from rrl.transforms.safety.base import SafetyLimit

__all__ = ["WorkspaceLimit"]


class WorkspaceLimit(SafetyLimit):
    """Clips a displacement so that the commanded position stays in a box.

        low + margin <= x + unit * u <= high - margin

    From outside the box, where a disturbance may have carried the end effector, only motion back into it is left,
    as fast as the action's bounds allow. What is limited is the command; ``margin`` is for what the robot overshoots.

    policy -> env: reads and writes ``action_key``.
    env -> policy: reads ``position_key``, writes ("safety", "workspace"); see :class:`SafetyLimit`.

    Args:
        low: Lower corner of the box in metres, a number or one a dimension.
        high: Upper corner, above the lower one.
        unit: Metres that one unit of the action stands for.
        margin: Metres by which the box of commands is smaller on every side, a number or one a dimension, not negative.
        position_key: Position x, ``[*batch, n_act]`` in metres.
        action_key: The displacement u, ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If a number is not finite, the margins leave no box, ``unit`` is not positive, or sizes do not fit.
        KeyError: If position or action is missing.
        RuntimeError: If actions pass the inverse without an environment or before a reset.

    """

    def __init__(
        self,
        low: float | Sequence[float],
        high: float | Sequence[float],
        unit: float = 1.0,
        margin: float | Sequence[float] = 0.0,
        position_key: NestedKey = "end_effector_position",
        action_key: NestedKey = ACTION,
    ) -> None:
        super().__init__("workspace", [position_key], action_key)
        room = per_dimension("margin", margin, minimum=0.0)
        self.low, self.high = per_dimension("low", low) + room, per_dimension("high", high) - room
        if not (self.high > self.low).all():
            raise ValueError(
                f"high must be above low in every dimension, with margins between, got low {low!r}, high {high!r} and "
                f"margin {margin!r}."
            )
        self.unit = per_dimension("unit", unit, positive=True)

    def measure(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return the position."""
        return self.require(tensordict, self.in_keys[0])

    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Clip the displacement to what leads to the box's faces."""
        low, high, unit = self.low.to(measured), self.high.to(measured), self.unit.to(measured)
        return torch.clamp(action, (low - measured) / unit, (high - measured) / unit)

    def check_sizes(self, observation_spec: Composite, action_size: int) -> None:
        """Hold box, unit and position to the action's size."""
        for name, value in (("low", self.low), ("high", self.high), ("unit", self.unit)):
            check_length(name, value, action_size, "the action")
        size = observation_spec[self.in_keys[0]].shape[-1]
        if size != action_size:
            raise ValueError(
                f"The position {self.in_keys[0]!r} has {size} dimensions, the action {action_size}: WorkspaceLimit "
                "needs a displacement for each coordinate."
            )
