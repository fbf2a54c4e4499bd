"""A guard against observations that are not numbers."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite

from rrl.checks import check_whole, require
from rrl.keys import BASE_ACTION, SAFETY
from rrl.slot_masks import any_done, merge, truncate
from rrl.transforms.base import Mask, Memory, SlotTransform

log = logging.getLogger(__name__)


class FiniteObservation(SlotTransform):
    """An end of the episode where a sensor, the controller or the reward gives NaN or infinity.

    In the list it stands last, so that it sees what the policy reads. In such a step the slot's
    entries keep the value of the step before, a reward becomes zero, and the episode is truncated:
    nobody acts on what was put in, and the transition can be learned from. At a reset they keep
    what the slot showed last, or zeros if it has shown nothing yet, and the episode ends with its
    first step. In that step the transforms before this one get NaN as they gave it, so that
    :class:`~rrl.FiniteAction` holds the command where the controller's action was lost.
    An environment that resets itself within a step cannot be told to end, and goes on.

    env -> policy: reads and corrects ``in_keys`` and all rewards; sets "truncated" and "done";
    writes ("safety", "observation"), bool ``[*batch, 1]``: whether the step or the reset had such a
    number, or the step ends an episode whose reset had.
    policy -> env: gives NaN back, see above.

    Args:
        in_keys: Observations ``[*batch, ...]``; what is not of floating point is left alone.
        patience: How many steps and resets with such a number are borne without an episode that
            ends well between them; a sensor that is gone for good is not a matter of luck.

    Raises:
        ValueError: If ``patience`` is no whole number of at least 0.
        KeyError: If an observation is missing.
        FloatingPointError: If there is no patience left.
    """

    FLAG = (SAFETY, "observation")
    written = ("flag",)

    def __init__(self, in_keys: Sequence[NestedKey], patience: int = 10) -> None:
        super().__init__(in_keys=list(in_keys), out_keys=[self.FLAG])
        self.patience = check_whole("patience", patience, 0)
        self._in_a_row = 0

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        values = self._floats(td, self.in_keys)
        lost = self._replace(td, values, mask)
        flag = _any_of(lost, td)
        return self._memory(values, lost, flag, blind=flag)

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        # What an episode that has started shows is a reset's; the reward is the last step's.
        started = any_done(next_td) if self.resets_itself() else None
        rewards = self.container.reward_keys
        values = self._floats(next_td, (*self.in_keys, *rewards))
        lost = self._replace(next_td, values, mask, started)
        flag = _any_of(lost, next_td) | self.recall("blind")
        if mask is not None:
            flag = flag & mask.unsqueeze(-1)
        if flag.any():
            if not self.resets_itself():
                truncate(next_td, flag)
        elif self._in_a_row and any_done(next_td).any():
            self._in_a_row = 0
        seen = {key: value for key, value in values.items() if key not in rewards}
        return self._memory(seen, {}, flag, blind=torch.zeros_like(flag))

    def _advance_or_start(
        self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask, started: Tensor
    ) -> Memory:
        memory = self._advance(td, next_td, mask)
        first = self._first(next_td, started)
        flag = first["flag"] | memory["flag"]  # of the last step, and of what it has started
        return merge(started, first | {"flag": flag}, memory)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.memory and self.memory["blind"].any():
            present = [key for key in self.in_keys if key in tensordict.keys(True, True)]
            for key, value in self._floats(tensordict, present).items():
                nothing = torch.full_like(value, torch.nan)
                tensordict.set(key, merge(self.memory[f"lost {key}"], nothing, value))
        return tensordict

    def _replace(
        self,
        td: TensorDictBase,
        values: dict[NestedKey, Tensor],
        mask: Mask,
        started: Tensor | None = None,
    ) -> dict[NestedKey, Tensor]:
        """Put what was known last in the place of what is not finite, in ``td`` and ``values``.

        Args:
            td: What is corrected.
            values: Of its entries.
            mask: Slots that count.
            started: Slots of which the rewards alone count, bool ``[*batch]``; None: none.

        Returns:
            Of every entry with such a number, in which slots, bool ``[*batch]``.
        """
        if not values or torch.cat([value.flatten() for value in values.values()]).isfinite().all():
            return {}
        lost = {}
        for key, value in values.items():
            slots = ~value.isfinite().reshape(*td.batch_size, -1).all(-1)
            slots = slots if mask is None else slots & mask
            slots = slots if started is None or key not in self.in_keys else slots & ~started
            if slots.any():
                lost[key] = slots
                kept = self.memory.get(f"known {key}", torch.zeros_like(value))
                values[key] = merge(slots, kept, value)
                td.set(key, values[key])
        if lost:
            self._bear(lost)
        return lost

    def _memory(
        self,
        values: Mapping[NestedKey, Tensor],
        lost: Mapping[NestedKey, Tensor],
        flag: Tensor,
        blind: Tensor,
    ) -> Memory:
        # Copies: an environment may change its own tensors in place.
        known = {f"known {key}": value.clone() for key, value in values.items()}
        nowhere = torch.zeros_like(flag[..., 0])
        slots = {f"lost {key}": lost.get(key, nowhere) for key in values}
        return known | slots | {"flag": flag, "blind": blind}

    def _floats(self, td: TensorDictBase, keys: Iterable[NestedKey]) -> dict[NestedKey, Tensor]:
        values = {key: require(self, td, key) for key in keys}
        return {key: value for key, value in values.items() if value.is_floating_point()}

    def _bear(self, broken: Iterable[NestedKey]) -> None:
        # What the controller says follows from what it reads.
        names = ", ".join(str(key) for key in broken if key != BASE_ACTION) or BASE_ACTION
        self._in_a_row += 1
        if self._in_a_row > self.patience:
            raise FloatingPointError(
                f"{names}: expected finite numbers, got NaN or infinity in {self._in_a_row} steps "
                "or resets without an episode that ended well between them; see to the sensor, the "
                "controller or the reward that gives them"
            )
        log.warning("%s: NaN or infinity; the episode ends, and what was known last is kept", names)

    def get_extra_state(self) -> dict[str, Any]:
        """Return the memory, and what was borne in a row, for ``state_dict``."""
        return {**super().get_extra_state(), "in_a_row": self._in_a_row}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take the memory, and what was borne in a row, from a ``state_dict``."""
        super().set_extra_state(state)
        self._in_a_row = state["in_a_row"]

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the flag that says whether the step's numbers were finite."""
        for key in self.in_keys:
            require(self, observation_spec, key)
        shape = (*observation_spec.shape, 1)
        flag = Binary(n=1, shape=shape, dtype=torch.bool, device=observation_spec.device)
        return self.add_spec(observation_spec, self.FLAG, flag, "name of the limit")


def _any_of(lost: Mapping[NestedKey, Tensor], td: TensorDictBase) -> Tensor:
    """Return the slots of any entry, bool ``[*batch, 1]``."""
    flag = torch.zeros((*td.batch_size, 1), dtype=torch.bool, device=td.device)
    for slots in lost.values():
        flag = flag | slots.unsqueeze(-1)
    return flag
