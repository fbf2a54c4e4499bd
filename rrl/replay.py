"""Replay for stacked seeds: every seed draws its own batches from its own transitions."""

from __future__ import annotations

from typing import Any

import torch
from torchrl.data.replay_buffers.samplers import Sampler
from torchrl.data.replay_buffers.storages import Storage

from rrl.slot_random import SlotGenerators


class StackedSampler(Sampler):
    """Uniform sampling with replacement, independently for every seed.

    The storage holds transitions of ``S`` seeds interleaved: entry ``t * S + s`` is seed ``s``'s transition ``t``.
    A request for ``k * S * B`` samples returns indices in the order ``[k, S, B]``, where seed ``s``'s indices come
    from its own generator and point to its own entries.

    Args:
        num_seeds: size ``S`` of the stack.
        seed: seed ``s`` draws what ``seed + s`` alone would draw.
        batch_size: size ``B`` of one seed's batch.
    """

    def __init__(self, num_seeds: int, seed: int, batch_size: int) -> None:
        self.num_seeds, self.batch_size = num_seeds, batch_size
        self.generators = SlotGenerators(seed, num_seeds, stream="replay")

    def sample(self, storage: Storage, batch_size: int) -> tuple[torch.Tensor, dict[str, Any]]:
        """Draw ``batch_size`` indices, a multiple of ``S * B``."""
        k, rest = divmod(batch_size, self.num_seeds * self.batch_size)
        if rest:
            raise ValueError(
                f"expected a multiple of {self.num_seeds} seeds x {self.batch_size} samples, got {batch_size}"
            )
        times = self.generators.integers(len(storage) // self.num_seeds, (k, self.batch_size))
        seeds = torch.arange(self.num_seeds).view(-1, 1, 1)
        return (times * self.num_seeds + seeds).transpose(0, 1).flatten(), {}

    def state_dict(self) -> dict[str, Any]:
        """The generators' state."""
        return self.generators.state_dict()

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the generators' state."""
        self.generators.load_state_dict(state_dict)

    def _empty(self) -> None:
        """Nothing to forget: every draw looks at the storage anew."""

    def dumps(self, path: Any) -> None:
        """Nothing to write: :meth:`state_dict` has it all."""

    def loads(self, path: Any) -> None:
        """Nothing to read."""
