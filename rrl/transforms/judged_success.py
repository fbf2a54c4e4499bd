"""Success where no sensor knows it: a person says so."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torchrl.data import Binary, Composite

from rrl.keys import SUCCESS
from rrl.transforms.base import Mask, Memory, SlotTransform


class JudgedSuccess(SlotTransform):
    """An entry for success, False until somebody judges the episode.

    The paper's success on the robot is a person's judgement. Whoever drives the environment
    replaces the entry in the step in which it comes, and ends the episode; a trainer does so for
    its person.

    env -> policy: writes ``out_key``, bool ``[*batch, 1]``.

    Args:
        out_key: The entry; may be nested.

    Raises:
        ValueError: If the observations hold ``out_key`` already.
        RuntimeError: If it is called outside an environment.
    """

    def __init__(self, out_key: NestedKey = SUCCESS) -> None:
        self._out_key = unravel_key(out_key)
        super().__init__(out_keys=[self._out_key])

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        flag = torch.zeros((*td.batch_size, 1), dtype=torch.bool, device=td.device)
        return {"success": flag}

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        return self._first(next_td, mask)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the entry."""
        shape = (*observation_spec.shape, 1)
        flag = Binary(n=1, shape=shape, dtype=torch.bool, device=observation_spec.device)
        return self.add_spec(observation_spec, self._out_key, flag, "out_key")
