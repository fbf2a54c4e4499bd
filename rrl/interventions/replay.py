"""What a replay buffer makes of the steps that an operator has taken over."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import RandomSampler, Storage

from rrl.checks import check_share, require
from rrl.keys import ACTION, EXCEEDS_AUTHORITY, INTERVENED, INTERVENTION
from rrl.transforms.base import sibling


def relabel_interventions(data: TensorDictBase, action_key: NestedKey = ACTION) -> TensorDictBase:
    """Put an operator's residual in the place of the policy's action, where one has taken over.

    A collector stores what the policy said. Give it this function as ``postproc``, or call it
    before ``ReplayBuffer.extend``.

    Args:
        data: Steps ``[..., T]`` with what :class:`~rrl.transforms.Intervention` writes in ``next``.
        action_key: The policy's action.

    Returns:
        ``data`` with the action as it is to be stored, and two flags of the transition beside it,
        "intervened" and "exceeds_authority", bool ``[..., T, 1]``. The latter says that no
        residual gives the command: what was executed is not what is stored.

    Raises:
        KeyError: If no Intervention has written into the data.
    """
    key = sibling(action_key, INTERVENTION)
    remedy = "; is there an Intervention among the environment's transforms?"
    step = require("relabel_interventions", data, unravel_key(("next", key)), remedy, group=True)
    said = data.get(action_key)
    data.set(action_key, torch.where(step["active"], step["action"].to(said), said))
    data.set(sibling(action_key, INTERVENED), step["active"])
    return data.set(sibling(action_key, EXCEEDS_AUTHORITY), step["exceeds"])


class InterventionSampler(RandomSampler):
    """Draws a share of every batch from the steps with a flag, and the rest from all steps.

    Both are uniform with replacement. The share is spread evenly over a batch, so that each part
    of it has it too. As long as there is no step with the flag all are drawn from all steps. There
    is one storage, and nothing to keep or to save beside it.

    Args:
        share: Part of every batch, in [0, 1].
        key: The flag, bool ``[n, 1]``.

    Raises:
        ValueError: If the share is not in [0, 1].
        KeyError: When drawing, if the storage does not hold the flag.
        TypeError: When drawing, if the storage holds no TensorDict, as TorchRL's default one.
    """

    def __init__(self, share: float, key: NestedKey = INTERVENED) -> None:
        self.share, self.key = check_share("share", share), key

    def sample(self, storage: Storage, batch_size: int) -> tuple[Tensor, dict[str, Any]]:
        """Return indices ``[batch_size]`` into a storage of one dimension.

        Raises:
            TypeError: If the storage holds no TensorDict.
        """
        index, info = super().sample(storage, batch_size)
        stored: Any = storage[:]
        if not isinstance(stored, TensorDictBase):
            raise TypeError(
                "storage: expected one that holds a TensorDict, such as LazyTensorStorage, got a "
                f"{type(storage).__name__}"
            )
        remedy = "; store steps as relabel_interventions leaves them"
        flagged = require(self, stored, self.key, remedy).flatten().nonzero().flatten()
        if len(flagged):
            chosen = flagged[torch.randint(len(flagged), (batch_size,), generator=self._rng)]
            count = torch.arange(batch_size + 1, dtype=torch.float64) * self.share
            theirs = ((count + 1e-9).floor().diff() > 0).to(index.device)  # a storage may be on GPU
            index = torch.where(theirs, chosen.to(index), index)
        return index, info
