"""What a quantity has come to in the episode so far."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import Composite, Unbounded

from rrl.checks import check, require
from rrl.keys import SO_FAR, leaf
from rrl.slot_masks import any_done, merge
from rrl.transforms.base import Mask, Memory, SlotTransform

REDUCTIONS: Mapping[str, Callable[[Tensor, Tensor], Tensor]] = {
    "max": torch.maximum,
    "min": torch.minimum,
    "sum": torch.add,
    "last": lambda before, now: now,
}
"""From the value so far and that of this step to the new value so far."""


class EpisodeValue(SlotTransform):
    """The largest, least or last value, or the sum, of a quantity in the episode so far.

    A step's share in what an episode comes to is by how much the value so far changes in it; the
    shares of all steps sum up to the episode's value, whatever the reduction. It is what a
    constraint on an episode's value charges a step for.

    env -> policy: reads the keys of ``reductions``, writes ("so_far", name) for each, float32
    ``[*batch, 1]``; 0 before an episode's first step. The name is the last part of the key. Of an
    environment that resets itself within a step, ``step_and_maybe_reset`` gives in ``next`` what
    the ended episode has come to.

    Args:
        reductions: ``max``, ``min``, ``sum`` or ``last`` for each observation, of one number a
            slot.

    Raises:
        ValueError: If a reduction is unknown, two names are the same, or an observation is not one
            number a slot.
        KeyError: If an observation is missing.
        RuntimeError: If it is called outside an environment, where there is no order in time.
    """

    def __init__(self, reductions: Mapping[NestedKey, str]) -> None:
        keys = [unravel_key(key) for key in reductions]
        names = [leaf(key) for key in keys]
        different = len(set(names)) == len(names)
        check("reductions", keys, "keys whose last parts differ, which name the results", different)
        super().__init__(in_keys=keys, out_keys=[(SO_FAR, name) for name in names])
        self.reductions = dict(zip(names, reductions.values(), strict=True))
        for name, reduction in self.reductions.items():
            check(name, reduction, f"one of {', '.join(REDUCTIONS)}", reduction in REDUCTIONS)
        self.written = names
        self._stepped: Memory = {}

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        nothing = torch.zeros(*td.batch_size, 1, dtype=torch.float32, device=td.device)
        begun = torch.zeros_like(nothing, dtype=torch.bool)
        return dict.fromkeys(self.reductions, nothing) | {"begun": begun}

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        begun, memory = self.recall("begun"), {}
        for key, (name, reduction) in zip(self.in_keys, self.reductions.items(), strict=True):
            now = require(self, next_td, key).to(torch.float32)
            so_far = REDUCTIONS[reduction](self.memory[name], now)
            memory[name] = torch.where(begun, so_far, now)
        return memory | {"begun": torch.ones_like(begun)}

    def _advance_or_start(
        self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask, started: Tensor
    ) -> Memory:
        self._stepped = self._advance(td, next_td, mask)
        return merge(started, self._first(next_td, started), self._stepped)

    def _post_step_mdp_hooks(
        self, tensordict: TensorDictBase, tensordict_: TensorDictBase
    ) -> tuple[TensorDictBase, TensorDictBase]:
        if self.resets_itself():  # TorchRL has put NaN there by now
            following = tensordict.get("next")
            ended = any_done(following)
            for name, key in zip(self.reductions, self.out_keys, strict=True):
                following.set(key, merge(ended, self._stepped[name], following.get(key)))
        return tensordict, tensordict_

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add one number a slot for each quantity.

        Raises:
            ValueError: If a quantity is not one number a slot.
        """
        batch = observation_spec.shape
        for key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            shape = require(self, observation_spec, key).shape
            if shape != (*batch, 1):
                raise ValueError(
                    f"{key!r}: expected one number a slot, of shape {(*batch, 1)}, "
                    f"got {tuple(shape)}"
                )
            spec = Unbounded((*batch, 1), dtype=torch.float32, device=observation_spec.device)
            self.add_spec(observation_spec, out_key, spec, "reductions")
        return observation_spec
