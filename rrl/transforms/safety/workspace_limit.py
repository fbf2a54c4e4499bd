"""A box that the end effector is not commanded out of."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check_length, check_lengths, check_whole, per_dimension, require
from rrl.keys import ACTION
from rrl.transforms.base import ActionLimits, Mask, Memory
from rrl.transforms.safety.base import SafetyLimit, check_sizes_equal
from rrl.transforms.safety.sums import total

_SINCE = "since"
"""The commands that may have been carried out since the position was measured, oldest first."""


class WorkspaceLimit(SafetyLimit):
    """A box that the end effector is not commanded out of.

        low + margin <= x + unit * u <= high - margin

    From outside the box, where a disturbance may have carried the end effector, only motion back
    into it is left, as fast as the action's bounds allow. While the position is not finite, the end
    effector is not moved.

    An arm lags behind its commands, and a position may be measured late. With ``delay`` each of the
    last ``delay`` commands may have been carried out since the measurement, or not yet: x is any
    position between, and the worst of them counts on every side.

    What is guaranteed is that the end effector stays in the box if it starts in it. It assumes that
    the set point is put relative to where the tool is, that ``delay`` is not less than the steps by
    which the position is late and those that the arm lags, together, and ``margin`` not less than
    it overshoots.

    policy -> env: reads and writes ``action_key``.
    env -> policy: reads ``position_key``, writes ("safety", "workspace"); see :class:`SafetyLimit`.

    Args:
        low: Lower corner of the box, a number or one for each dimension [m].
        high: Upper corner, above the lower one [m].
        unit: Length that one unit of the action stands for, positive [m].
        margin: How much smaller the box of commands is on every side, a number or one for each
            dimension, not negative [m].
        delay: Control steps by which the position is late and the arm lags, not negative.
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
        delay: int = 0,
        position_key: NestedKey = "end_effector_position",
        action_key: NestedKey = ACTION,
    ) -> None:
        super().__init__("workspace", [position_key], action_key)
        room = per_dimension("margin", margin, minimum=0.0)
        lower, upper = per_dimension("low", low), per_dimension("high", high)
        check_lengths(low=lower, high=upper, margin=room)
        self.low, self.high = lower + room, upper - room
        if not (self.high > self.low).all():
            raise ValueError(
                f"high: expected numbers above low ({low!r}) with the margin ({margin!r}) on both "
                f"sides, got {high!r}"
            )
        self.unit = per_dimension("unit", unit, positive=True)
        self.delay = check_whole("delay", delay, 0)

    def measure(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return the position."""
        return require(self, tensordict, self.in_keys[0])

    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Clip the displacement to what leads to the box's faces."""
        low, high, unit = self.low.to(measured), self.high.to(measured), self.unit.to(measured)
        since = unit * self.recall(_SINCE)  # (*batch, delay, n)
        least = measured + total(since.clamp_max(0), -2)
        most = measured + total(since.clamp_min(0), -2)
        return torch.clamp(action, (low - least) / unit, (high - most) / unit)

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        memory = super()._first(td, mask)
        nothing = self.nothing(td).unsqueeze(-2)
        return memory | {_SINCE: nothing.expand(*nothing.shape[:-2], self.delay, -1).clone()}

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        memory = super()._advance(td, next_td, mask)
        executed = torch.cat([self.recall(_SINCE), self.executed(td).unsqueeze(-2)], -2)
        return memory | {_SINCE: executed.narrow(-2, 1, self.delay)}

    def check_sizes(self, sizes: dict[NestedKey, int], action_size: int) -> None:
        """Hold box, unit and position to the action's size."""
        for name, value in (("low", self.low), ("high", self.high), ("unit", self.unit)):
            check_length(name, value, action_size, "the action")
        check_sizes_equal(sizes, action_size)
