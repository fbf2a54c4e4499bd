"""A Gaussian squashed by tanh, whose random numbers are handed to it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.distributions import Distribution
from torchrl.envs.utils import ExplorationType, exploration_type

from rrl.algorithms.networks import StackedMLP
from rrl.algorithms.symmetric_actor import SymmetricActor
from rrl.keys import ACTION
from rrl.slot_random import SlotGenerators

__all__ = ["GaussianHead", "SquashedGaussian", "SquashedGaussianPolicy"]

LOG_STD_RANGE = (-5.0, 2.0)


class GaussianHead(nn.Module):
    """Split a network's output ``[..., 2 n]`` into mean and standard deviation, ``[..., n]`` each.

    Args:
        initial_std: standard deviation where the network gives 0.

    Raises:
        ValueError: if it is not within exp(-5) and exp(2), where the logarithm is clipped.

    """

    def __init__(self, initial_std: float) -> None:
        super().__init__()
        low, high = LOG_STD_RANGE
        if not math.exp(low) <= initial_std <= math.exp(high):
            raise ValueError(
                f"initial_std: expected {math.exp(low):.4f} to {math.exp(high):.1f}, got {initial_std}"
            )
        self.offset = math.log(initial_std)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation."""
        loc, log_std = x.chunk(2, -1)
        return loc, (log_std + self.offset).clamp(*LOG_STD_RANGE).exp()


class SquashedGaussian(Distribution):
    """Distribution of a = tanh(loc + scale * noise) for a standard normal ``noise`` that is given, not drawn.

    A distribution that draws from the global generator would tie the seeds of a stack together. The log-probability is
    multiplied by ``temperature``: TorchRL's loss multiplies it by one number for the whole batch, and the learners of a
    stack have one each. Both are data, and a compiled update needs no generator.

    Args:
        loc, scale: mean and standard deviation before the tanh, ``[*batch, n]``.
        noise: standard normal numbers, ``[*batch, n]``.
        temperature: factor on the log-probability, ``[*batch]``.

    """

    arg_constraints = {}  # noqa: RUF012 - the base class's name

    def __init__(self, loc: Tensor, scale: Tensor, noise: Tensor, temperature: Tensor) -> None:
        self.loc, self.scale, self.noise, self.temperature = loc, scale, noise, temperature
        super().__init__(loc.shape[:-1], loc.shape[-1:], validate_args=False)

    def rsample_and_log_prob(self, sample_shape: Sequence[int] = ()) -> tuple[Tensor, Tensor]:
        """Return the action ``[*batch, n]`` and its log-probability times the temperature, ``[*batch]``."""
        before = self.loc + self.scale * self.noise
        normal = -0.5 * self.noise.square() - self.scale.log() - 0.5 * math.log(2 * math.pi)
        # log(1 - tanh(x)^2) without cancellation
        slope = 2.0 * (math.log(2.0) - before - nn.functional.softplus(-2.0 * before))
        return before.tanh(), (normal - slope).sum(-1) * self.temperature


class SquashedGaussianPolicy(TensorDictModuleBase):
    """The policy that acts: samples under random exploration, else gives the tanh of the mean.

    Reads ``in_keys`` ``[S * E, ...]``, seed-major, writes ``action``; noise comes from one generator a seed.

    Args:
        network: from the concatenated inputs to ``2 n`` numbers.
        head: makes mean and standard deviation of them.
        in_keys: observation entries.
        generators: one a seed.

    """

    def __init__(
        self,
        network: StackedMLP | SymmetricActor,
        head: GaussianHead,
        in_keys: Sequence[NestedKey],
        generators: SlotGenerators,
    ) -> None:
        super().__init__()
        self.in_keys, self.out_keys = list(in_keys), [ACTION]
        self.network, self.head, self.generators = network, head, generators

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``."""
        loc, scale = self.head(self.network(*(tensordict.get(key) for key in self.in_keys)))
        if exploration_type() in (ExplorationType.RANDOM, None):
            size = loc.shape[-1]
            noise = self.generators.normal((loc.numel() // size // self.network.num_seeds, size))
            loc = loc + scale * noise.reshape(loc.shape)
        return tensordict.set(ACTION, torch.tanh(loc))

    def get_extra_state(self) -> dict[str, Any]:
        """The generators' state."""
        return self.generators.state_dict()

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the generators' state."""
        self.generators.load_state_dict(state)
