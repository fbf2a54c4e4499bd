"""A recorded sequence of actions as the controller."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check
from rrl.controllers.base import State, StatefulController
from rrl.keys import BASE_ACTION


class ReplayController(StatefulController):
    """A sequence of actions played open loop, from its start in every episode.

    Args:
        actions: ``[T, n_act]``, of several agents ``[T, n, n_act]``; the first is given with the
            observation of the reset.
        after_end: What follows the last action: "hold" repeats it, "zero" gives zeros.
        out_key: Where the action ``[*batch, n_act]`` goes.

    Raises:
        ValueError: If the sequence is empty, has no dimension of time or is not finite, or
            ``after_end`` is unknown.
    """

    def __init__(
        self,
        actions: Tensor | Sequence[Sequence[float]],
        after_end: str = "hold",
        out_key: NestedKey = BASE_ACTION,
    ) -> None:
        super().__init__([], out_key)
        sequence = torch.as_tensor(actions).detach().clone()
        if not sequence.is_floating_point():
            sequence = sequence.to(torch.get_default_dtype())
        is_sequence = sequence.ndim >= 2 and sequence.numel() > 0
        check("actions", list(sequence.shape), "the shape [T, n_act], none of them 0", is_sequence)
        check("actions", "NaN or infinity", "finite numbers", bool(sequence.isfinite().all()))
        check("after_end", after_end, "'hold' or 'zero'", after_end in ("hold", "zero"))
        if after_end == "zero":
            sequence = torch.cat([sequence, torch.zeros_like(sequence[:1])])
        self.register_buffer("actions", sequence)  # (T, n_act), or (T + 1, n_act) with the zeros

    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Return the index of the next action, int64 ``[*batch]``."""
        batch, device = tensordict.batch_size, tensordict.device
        return {"index": torch.zeros(batch, dtype=torch.int64, device=device)}

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the next action of every slot ``[*batch, n_act]``."""
        index = self.state_for(tensordict)["index"]
        self.state = {"index": (index + 1).clamp_max(self.actions.shape[0] - 1)}
        return self.actions[index]
