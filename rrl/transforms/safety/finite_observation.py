"""A guard against observations that are not numbers."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torchrl.data import Binary, Composite

from rrl.checks import check_whole, require
from rrl.keys import REWARD, SAFETY
from rrl.slot_masks import merge
from rrl.transforms.base import Mask, Memory, SlotTransform, any_done
from rrl.transforms.safety.truncation import truncate

__all__ = ["FiniteObservation"]

log = logging.getLogger(__name__)


class FiniteObservation(SlotTransform):
    """An end of the episode where a sensor, the controller or the reward gives NaN or infinity.

    In the list it stands last, so that it sees what the policy reads. In such a step the slot's
    entries keep the value of the step before, a reward becomes zero, and the episode is truncated:
    nobody acts on what was put in, and the transition can be learned from. What is not finite at a
    reset stays, for there is nothing to keep; :class:`~rrl.FiniteAction` holds the command then.
    An environment that resets itself within a step cannot be told to end, and goes on.

    env -> policy: reads and corrects ``in_keys`` and ``reward_key``; sets "truncated" and "done";
    writes ("safety", "observation"), bool ``[*batch, 1]``: whether the step had such a number.

    Args:
        in_keys: Observations ``[*batch, ...]``; what is not of floating point is left alone.
        patience: How many steps with such a number are borne without an episode that ends well
            between them; a sensor that is gone for good is not a matter of luck.
        reward_key: The reward ``[*batch, 1]``.

    Raises:
        ValueError: If ``patience`` is no whole number of at least 0.
        KeyError: If an observation is missing.
        FloatingPointError: If there is no patience left.
    """

    FLAG = (SAFETY, "observation")

    def __init__(
        self, in_keys: Sequence[NestedKey], patience: int = 10, reward_key: NestedKey = REWARD
    ) -> None:
        super().__init__(in_keys=list(in_keys), out_keys=[self.FLAG])
        self.patience = check_whole("patience", patience, 0)
        self._reward_key, self._in_a_row = reward_key, 0

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        return {"flag": torch.zeros((*td.batch_size, 1), dtype=torch.bool, device=td.device)}

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        flag, broken = self._first(next_td, mask)["flag"], self._not_finite(next_td)
        for key in broken:
            value = next_td.get(key)
            lost = ~value.isfinite().reshape(*next_td.batch_size, -1).all(-1)
            if self.resets_itself():  # what TorchRL puts in the place of an episode's last entries
                lost = lost & ~any_done(next_td)
            lost = lost if mask is None else lost & mask
            kept = torch.zeros_like(value) if key == self._reward_key else td.get(key)
            next_td.set(key, merge(lost, kept, value))
            flag = flag | lost.unsqueeze(-1)
        if flag.any():
            self._bear(broken)
            if not self.resets_itself():
                truncate(next_td, flag)
        elif any_done(next_td).any():
            self._in_a_row = 0
        return {"flag": flag}

    def _bear(self, broken: Sequence[NestedKey]) -> None:
        names = ", ".join(map(str, broken))
        self._in_a_row += 1
        if self._in_a_row > self.patience:
            raise FloatingPointError(
                f"{names}: expected finite numbers, got NaN or infinity in {self._in_a_row} steps "
                "without an episode that ended well between them; see to the sensor, the "
                "controller or the reward that gives them"
            )
        log.warning("%s: NaN or infinity; the episode ends, and what was known last is kept", names)

    def _not_finite(self, td: TensorDictBase) -> list[NestedKey]:
        """Return the entries in which something is not finite, most often none."""
        values = {key: require(self, td, key) for key in (*self.in_keys, self._reward_key)}
        floats = {key: value for key, value in values.items() if value.is_floating_point()}
        if torch.cat([value.flatten() for value in floats.values()]).isfinite().all():
            return []
        return [key for key, value in floats.items() if not value.isfinite().all()]

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the flag that says whether the step's numbers were finite."""
        for key in self.in_keys:
            require(self, observation_spec, key)
        shape = (*observation_spec.shape, 1)
        flag = Binary(n=1, shape=shape, dtype=torch.bool, device=observation_spec.device)
        return self.add_spec(observation_spec, self.FLAG, flag, "name of the limit")
