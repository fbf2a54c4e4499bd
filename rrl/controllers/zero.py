"""The controller of the arm "RL only"."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.controllers.base import Controller
from rrl.keys import BASE_ACTION

__all__ = ["ZeroController"]


class ZeroController(Controller):
    """Does nothing: with it the policy is alone (the paper's baseline "RL only").

    Args:
        action_size: Length n_act of the action; None: that of the environment, which
            :class:`~rrl.transforms.ResidualAction` says.
        out_key: Where the zeros ``[*batch, n_act]`` go.

    Raises:
        ValueError: If ``action_size`` is not positive.
        RuntimeError: When run, if nobody said the action's size.

    """

    def __init__(self, action_size: int | None = None, out_key: NestedKey = BASE_ACTION) -> None:
        if action_size is not None and action_size < 1:
            raise ValueError(f"action_size must be at least 1, got {action_size}.")
        super().__init__([], out_key)
        self.action_size = action_size

    def fit(self, action_size: int) -> None:
        """Take the environment's action size, unless one was given."""
        self.action_size = self.action_size or action_size

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return zeros ``[*batch, n_act]``."""
        if self.action_size is None:
            raise RuntimeError(
                "ZeroController has no environment to take the action's size from: pass action_size."
            )
        return torch.zeros((*tensordict.batch_size, self.action_size), device=tensordict.device)
