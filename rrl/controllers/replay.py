"""A recorded sequence of actions as the controller."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.controllers.base import State, StatefulController
from rrl.keys import BASE_ACTION

__all__ = ["ReplayController"]

_AFTER_END = ("hold", "zero")


class ReplayController(StatefulController):
    """Plays a sequence of actions open loop, from its start in every episode.

    Args:
        actions: ``[T, n_act]``; the first is given with the observation of the reset.
        after_end: What follows the last action: "hold" repeats it, "zero" gives zeros.
        out_key: Where the action ``[*batch, n_act]`` goes.

    Raises:
        ValueError: If the sequence is empty, not two-dimensional or not finite, or ``after_end`` is
            unknown.

    """

    def __init__(
        self,
        actions: Tensor | Sequence[Sequence[float]],
        after_end: str = "hold",
        out_key: NestedKey = BASE_ACTION,
    ) -> None:
        super().__init__([], out_key)
        tensor = torch.as_tensor(actions, dtype=torch.float32).detach().clone()
        if tensor.ndim != 2 or tensor.numel() == 0:
            raise ValueError(
                f"actions must have the shape [T, n_act], none of them 0, got {tuple(tensor.shape)}."
            )
        if not tensor.isfinite().all():
            raise ValueError("actions must be finite; the sequence holds NaN or infinity.")
        if after_end not in _AFTER_END:
            raise ValueError(f"after_end must be one of {_AFTER_END}, got {after_end!r}.")
        if after_end == "zero":
            tensor = torch.cat([tensor, torch.zeros_like(tensor[:1])])
        self.register_buffer("actions", tensor)  # (T, n_act), or (T + 1, n_act) with the zeros

    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Return the index of the next action, int64 ``[*batch]``."""
        batch, device = tensordict.batch_size, tensordict.device
        return {"index": torch.zeros(batch, dtype=torch.int64, device=device)}

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the next action of every slot ``[*batch, n_act]``."""
        index = self.state_for(tensordict)["index"]
        self.state = {"index": (index + 1).clamp_max(self.actions.shape[0] - 1)}
        return self.actions[index]
