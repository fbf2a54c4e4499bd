"""Batches of which a share comes from steps that an operator has taken over."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import NestedKey
from torch import Tensor
from torchrl.data import RandomSampler, Storage

from rrl.checks import check_share, require
from rrl.keys import INTERVENED

__all__ = ["InterventionSampler"]


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
    """

    def __init__(self, share: float, key: NestedKey = INTERVENED) -> None:
        self.share, self.key = check_share("share", share), key

    def sample(self, storage: Storage, batch_size: int) -> tuple[Tensor, dict[str, Any]]:
        """Return indices ``[batch_size]`` into a storage of one dimension."""
        index, info = super().sample(storage, batch_size)
        stored: Any = storage[:]
        remedy = "; store steps as relabel_interventions leaves them"
        flagged = require(self, stored, self.key, remedy).flatten().nonzero().flatten()
        if len(flagged):
            chosen = flagged[torch.randint(len(flagged), (batch_size,), generator=self._rng)]
            count = torch.arange(batch_size + 1, dtype=torch.float64) * self.share
            index = torch.where((count + 1e-9).floor().diff() > 0, chosen.to(index), index)
        return index, info
