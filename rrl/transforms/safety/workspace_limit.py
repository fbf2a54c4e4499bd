"""A box that the end effector is not commanded out of."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check_length, per_dimension, require
from rrl.keys import ACTION
from rrl.transforms.base import ActionLimits
from rrl.transforms.safety.base import SafetyLimit

__all__ = ["WorkspaceLimit"]


class WorkspaceLimit(SafetyLimit):
    """A box that the commanded position stays in.

        low + margin <= x + unit * u <= high - margin

    From outside the box, where a disturbance may have carried the end effector, only motion back
    into it is left, as fast as the action's bounds allow. What is limited is the command;
    ``margin`` is for what the robot overshoots. While the position is not finite, the end effector
    is not moved.

    policy -> env: reads and writes ``action_key``.
    env -> policy: reads ``position_key``, writes ("safety", "workspace"); see :class:`SafetyLimit`.

    Args:
        low: Lower corner of the box, a number or one for each dimension [m].
        high: Upper corner, above the lower one [m].
        unit: Length that one unit of the action stands for, positive [m].
        margin: How much smaller the box of commands is on every side, a number or one for each
            dimension, not negative [m].
        position_key: Position x, ``[*batch, n_act]`` [m].
        action_key: The displacement u, ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If a number is not finite, the margins leave no box, ``unit`` is not positive,
            or sizes do not fit.
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
                f"high: expected numbers above low ({low!r}) with the margin ({margin!r}) on both "
                f"sides, got {high!r}"
            )
        self.unit = per_dimension("unit", unit, positive=True)

    def measure(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return the position."""
        return require(self, tensordict, self.in_keys[0])

    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Clip the displacement to what leads to the box's faces."""
        low, high, unit = self.low.to(measured), self.high.to(measured), self.unit.to(measured)
        return torch.clamp(action, (low - measured) / unit, (high - measured) / unit)

    def check_sizes(self, sizes: dict[NestedKey, int], action_size: int) -> None:
        """Hold box, unit and position to the action's size."""
        for name, value in (("low", self.low), ("high", self.high), ("unit", self.unit)):
            check_length(name, value, action_size, "the action")
        for key, size in sizes.items():
            if size != action_size:
                raise ValueError(
                    f"{key!r}: expected {action_size} numbers, one for each dimension of the "
                    f"action, got {size}"
                )
