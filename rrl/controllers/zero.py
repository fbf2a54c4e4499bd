"""The controller of the arm "RL only"."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check_whole
from rrl.controllers.base import Controller
from rrl.keys import BASE_ACTION


class ZeroController(Controller):
    """A controller that does nothing: the policy is alone (the paper's baseline "RL only").

    Args:
        action_size: Length n_act of the action; None: that of the environment, which
            :class:`~rrl.transforms.ResidualAction` tells it.
        out_key: Where the zeros ``[*batch, n_act]`` go.

    Raises:
        ValueError: If ``action_size`` is not positive.
        RuntimeError: When run, if the action's size is not known.
    """

    def __init__(self, action_size: int | None = None, out_key: NestedKey = BASE_ACTION) -> None:
        super().__init__([], out_key)
        given = () if action_size is None else (check_whole("action_size", action_size, 1),)
        self._shape = torch.Size(given)

    def fit(self, shape: torch.Size) -> None:
        """Take the shape of the environment's action, unless a size was given."""
        self._shape = self._shape or shape

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return zeros ``[*batch, n_act]``."""
        if not self._shape:
            raise RuntimeError(
                "action_size: expected a number or an environment to take it from, got neither"
            )
        return torch.zeros(tensordict.batch_size + self._shape, device=tensordict.device)
