"""Composition of controllers."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor, nn

from rrl.checks import per_dimension
from rrl.controllers.base import Controller
from rrl.keys import BASE_ACTION

__all__ = ["SumController"]


class SumController(Controller):
    """Adds, scales and clips controllers: u = clip(sum_i w_i u_i).

    With one controller it scales or clips that one.

    Args:
        controllers: At least one controller.
        weights: w_i, one a controller, each a number or one a dimension; None: all 1.
        clip: Largest magnitude of the sum, a number or one a dimension, positive; None: no
            clipping.
        out_key: Where the action ``[*batch, n_act]`` goes.

    Raises:
        TypeError: If a member is not a controller.
        ValueError: If there is no controller, the number of weights differs, a weight is not
            finite, or ``clip`` is not positive.

    """

    def __init__(
        self,
        controllers: Sequence[Controller],
        weights: Sequence[float | Sequence[float]] | None = None,
        clip: float | Sequence[float] | None = None,
        out_key: NestedKey = BASE_ACTION,
    ) -> None:
        controllers = list(controllers)
        if not controllers:
            raise ValueError("SumController needs at least one controller, got none.")
        wrong = [type(c).__name__ for c in controllers if not isinstance(c, Controller)]
        if wrong:
            raise TypeError(
                f"Controllers were expected, got {wrong}. Wrap a policy in a PolicyController."
            )
        if weights is not None and len(weights) != len(controllers):
            raise ValueError(
                f"One weight a controller was expected: {len(controllers)} controllers, {len(weights)} weights."
            )
        keys = dict.fromkeys(unravel_key(key) for c in controllers for key in c.in_keys)
        super().__init__(list(keys), out_key)
        self.controllers = nn.ModuleList(controllers)
        for number, weight in enumerate(weights or ()):
            self.register_buffer(f"_weight{number}", per_dimension("weights", weight))
        self._weighted = weights is not None
        limit = None if clip is None else per_dimension("clip", clip, positive=True)
        self.register_buffer("_limit", limit)

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the clipped sum ``[*batch, n_act]``."""
        total: Tensor | None = None
        for number, controller in enumerate(self.controllers):
            assert isinstance(controller, Controller)
            action = controller.act(tensordict)
            if self._weighted:
                action = action * getattr(self, f"_weight{number}")
            total = action if total is None else total + action
        assert total is not None
        return total if self._limit is None else torch.clamp(total, -self._limit, self._limit)
