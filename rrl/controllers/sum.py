"""Composition of controllers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn

from rrl.checks import check, check_length, per_dimension
from rrl.controllers.base import Controller, clipped, floating
from rrl.keys import BASE_ACTION


class SumController(Controller):
    """A weighted and clipped sum of controllers, u = clip(sum_i w_i u_i).

    With one controller it scales or clips that one.

    Args:
        controllers: At least one controller, or what makes one.
        weights: w_i, one for each controller, each a number or one for each dimension; None: all 1.
        clip: Largest magnitude of the sum, a number or one for each dimension, positive; None: no
            clipping.
        out_key: Where the action ``[*batch, n_act]`` goes.

    Raises:
        TypeError: If a member is not a controller.
        ValueError: If there is no controller, one with a memory comes twice, the number of weights
            differs, a weight is not finite, or ``clip`` is not positive; when run, if actions,
            weights and ``clip`` do not fit together.
    """

    def __init__(
        self,
        controllers: Sequence[Controller | Callable[[], Controller]],
        weights: Sequence[float | Sequence[float]] | None = None,
        clip: float | Sequence[float] | None = None,
        out_key: NestedKey = BASE_ACTION,
    ) -> None:
        members: list[Any] = [
            c if isinstance(c, nn.Module) or not callable(c) else c() for c in controllers
        ]
        check("controllers", members, "at least one controller", bool(members))
        if wrong := [type(c).__name__ for c in members if not isinstance(c, Controller)]:
            raise TypeError(
                f"controllers: expected Controllers, got {wrong}; wrap a policy in a "
                "PolicyController"
            )
        stateful = [id(part) for c in members for part in c.stateful()]
        if len(set(stateful)) < len(stateful):
            raise ValueError(
                "controllers: expected each one with a memory once, got one of them twice; make "
                "another"
            )
        factors = [1.0] * len(members) if weights is None else list(weights)
        check("weights", weights, f"{len(members)}, one a controller", len(factors) == len(members))
        super().__init__(list(dict.fromkeys(key for c in members for key in c.in_keys)), out_key)
        self.controllers = nn.ModuleList(members)
        for number, weight in enumerate(factors):
            self.register_buffer(f"_weight{number}", per_dimension("weights", weight))
        limit = None if clip is None else per_dimension("clip", clip, positive=True)
        self.register_buffer("_limit", limit)

    def fit(self, middle: Tensor) -> None:
        """Pass the action's shape on: a member in the middle of the bounds would shift the sum."""
        super().fit(torch.zeros_like(middle))

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the clipped sum ``[*batch, n_act]``.

        Raises:
            ValueError: If the actions have different shapes.
        """
        total: Tensor | None = None
        for number, controller in enumerate(self.controllers):
            assert isinstance(controller, Controller)
            action = floating(controller.act(tensordict))
            weight = getattr(self, f"_weight{number}")
            check_length("weights", weight, action.shape[-1], f"{controller.called()}'s action")
            if total is not None and total.shape != action.shape:
                raise ValueError(
                    f"controllers: expected actions of one shape, got {tuple(total.shape)} and, of "
                    f"{controller.called()}, {tuple(action.shape)}"
                )
            weighted = action * weight.to(action.dtype)
            total = weighted if total is None else total + weighted
        assert total is not None
        if self._limit is not None:
            check_length("clip", self._limit, total.shape[-1], "the sum")
        return clipped(total, self._limit)
