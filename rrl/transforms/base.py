"""What the transforms of this project share: memory and random numbers slot by slot."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs.transforms import Transform

from rrl.slot_random import Seeded, SlotGenerators

__all__ = ["RandomTransform", "SlotTransform"]


class SlotTransform(Transform):
    """A transform with memory held slot by slot.

    What a subclass remembers is replaced and never changed in place, so a clone may start from the
    same tensors; generators and modules are copied by :meth:`clone`.
    """

    def clone(self) -> SlotTransform:
        """Return a copy without a parent that shares no state with this transform."""
        twin = super().clone()
        for name, value in twin.__dict__.items():
            if isinstance(value, SlotGenerators):
                twin.__dict__[name] = copy.deepcopy(value)
        for table in (twin._modules, twin._buffers):
            for name, value in table.items():
                table[name] = copy.deepcopy(value)
        return twin

    def require(self, tensordict: TensorDictBase, key: NestedKey, hint: str = "") -> Tensor:
        """Return an entry, or raise a KeyError that says what there is instead."""
        value = tensordict.get(key, None)
        if value is None:
            available = sorted(map(str, tensordict.keys(True, True)))
            raise KeyError(
                f"{type(self).__name__} needs the key {key!r}, which the tensordict does not hold. "
                f"{hint}Available keys: {available}."
            )
        return value

    def require_spec(self, observation_spec: Composite, key: NestedKey) -> TensorSpec:
        """Return the spec of an observation, or raise a KeyError that says what there is."""
        present = observation_spec.keys(True, True)
        if key not in present:
            raise KeyError(
                f"{type(self).__name__} needs the observation {key!r}, which the environment "
                f"does not give at this place. Observations: {sorted(map(str, present))}."
            )
        return observation_spec[key]

    def check_key_pairs(self) -> None:
        """Raise a ValueError unless there is one out key for each of at least one in key."""
        if not self.in_keys or len(self.in_keys) != len(self.out_keys):
            raise ValueError(
                f"{type(self).__name__} needs at least one in key and one out key for each, got "
                f"{self.in_keys} and {self.out_keys}."
            )


class RandomTransform(Seeded, SlotTransform):
    """A slot transform that draws numbers, each slot from its own generator.

    Args:
        seed: Seed of slot 0; slot i uses ``seed + i``. None: a new seed is drawn from torch's
            global generator at every reset of all slots, so ``torch.manual_seed`` and
            ``ParallelEnv.set_seed`` govern it.
        stream: Name that tells this transform's numbers from those of others with the same seed.

    """

    def __init__(self, *, seed: int | None, stream: str, **keys: Sequence[NestedKey]) -> None:
        super().__init__(**keys)
        self._follows_global_seed = seed is None
        self._generators = SlotGenerators(seed, 1, stream)

    def seed(self, seed: int | None) -> None:
        """Start the random numbers anew; see the constructor's ``seed``."""
        self._follows_global_seed = seed is None
        self._generators.seed(seed)

    def get_extra_state(self) -> dict[str, Any]:
        """Return the state of the generators for ``state_dict``."""
        return {
            "follows_global_seed": self._follows_global_seed,
            "generators": self._generators.state_dict(),
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take the state from a ``state_dict``."""
        self._follows_global_seed = state["follows_global_seed"]
        self._generators.load_state_dict(state["generators"])

    def start_episodes(self, batch: torch.Size, mask: Tensor | None) -> None:
        """Prepare the generators for a reset of the slots in ``mask`` (None: all)."""
        if mask is None and self._follows_global_seed:
            self._generators.seed(None)
        self._generators.resize(batch.numel())

    def slots(self, batch: torch.Size) -> SlotGenerators:
        """Return the generators, one for each slot of ``batch``."""
        self._generators.resize(batch.numel())
        return self._generators

    def draw_normal(self, batch: torch.Size, shape: torch.Size, mask: Tensor | None) -> Tensor:
        """Draw standard normal numbers ``[*batch, *shape]``, zeros where ``mask`` is False."""
        return self.slots(batch).normal(shape, mask).reshape(batch + shape)
