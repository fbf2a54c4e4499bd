"""The controller of the arm "RL only"."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check_whole
from rrl.controllers.base import Controller
from rrl.keys import BASE_ACTION


class ZeroController(Controller):
    """A controller that leaves all to the policy (the paper's baseline "RL only").

    Its action is the zero of the normalized range: the middle of the environment's bounds, which
    :class:`~rrl.transforms.ResidualAction` tells it, so that a residual of scale 1 reaches all of
    [low, high] and nothing else. Where bounds are symmetric, absent or not told it is 0; in a sum
    of controllers it adds 0.

    Args:
        action_size: Length n_act of the action; None: that of the environment.
        out_key: Where the action ``[*batch, n_act]`` goes.

    Raises:
        ValueError: If ``action_size`` is not positive.
        RuntimeError: When run, if the action's size is not known.
    """

    def __init__(self, action_size: int | None = None, out_key: NestedKey = BASE_ACTION) -> None:
        super().__init__([], out_key)
        self._action: Tensor | None = None
        if action_size is not None:
            self._action = torch.zeros(check_whole("action_size", action_size, 1))

    def fit(self, middle: Tensor) -> None:
        """Take the middle of the action's bounds, unless a given size is another one."""
        if self._action is None or self._action.shape == middle.shape:
            self._action = middle

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the middle of the bounds in every slot, ``[*batch, n_act]``.

        Raises:
            RuntimeError: If there is no size to take.
        """
        if self._action is None:
            raise RuntimeError(
                "action_size: expected a number or an environment to take it from, got neither"
            )
        shape = tensordict.batch_size + self._action.shape
        zeros = torch.zeros(shape, device=tensordict.device)
        return zeros + self._action.to(zeros.device)
