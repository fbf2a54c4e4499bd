"""Random numbers that belong to a slot: one generator for each environment of a batch."""

from __future__ import annotations

import hashlib
import operator
from collections import Counter
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv

_MAX_DRAWN_SEED = 2**31


class SlotGenerators:
    """One random generator for each slot, so that a slot's numbers do not depend on its neighbors.

    The generator of slot i is seeded from ``seed + i``: slot i of a batch draws, bit for bit, what
    the only slot of a batch of one seeded ``seed + i`` draws.

    Args:
        seed: Seed of slot 0. None draws a seed from torch's global generator at first use, which is
            what ``ParallelEnv.set_seed`` sets in its workers.
        stream: Name of the consumer. Two consumers with the same seed and different streams draw
            unrelated numbers; the empty stream uses ``seed + i`` itself.

    Attributes:
        number: Tells consumers with the same seed and stream apart, such as two equal noises; the
            one with 0 draws what it would draw alone.

    Raises:
        TypeError: If ``seed`` is neither an integer nor None.
    """

    def __init__(self, seed: int | None, stream: str = "") -> None:
        self.stream, self.number = stream, 0
        self.seed(seed)

    def seed(self, seed: int | None) -> None:
        """Start every slot anew from ``seed + i``; None: from torch's generator, at first use."""
        self._seed = _check_seed(seed)
        self._generators: list[torch.Generator] | None = None

    def renew(self) -> None:
        """Start anew from torch's generator, unless a seed was given."""
        if self._seed is None:
            self._generators = None

    def normal(
        self, batch: torch.Size, shape: Sequence[int] = (), mask: Tensor | None = None
    ) -> Tensor:
        """Draw standard normal numbers.

        Args:
            batch: Batch of the slots. With another number of slots than before, all start anew.
            shape: Shape of one slot's draw.
            mask: Slots that draw, bool ``[*batch]``; None means all. The others get zeros and
                their generators stay where they are.

        Returns:
            float32 ``[*batch, *shape]`` on the CPU.
        """
        return self._draw(torch.Tensor.normal_, batch, shape, mask)

    def uniform(
        self, batch: torch.Size, shape: Sequence[int] = (), mask: Tensor | None = None
    ) -> Tensor:
        """Draw numbers uniform in [0, 1); see :meth:`normal`."""
        return self._draw(torch.Tensor.uniform_, batch, shape, mask)

    def state_dict(self) -> dict[str, Any]:
        """Return seed and state of every generator, to be continued exactly."""
        states = None if self._generators is None else [g.get_state() for g in self._generators]
        number = {"number": self.number} if self.number else {}
        return {"seed": self._seed, "states": states, **number}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over the state of :meth:`state_dict`, including the number of slots."""
        self._seed, self.number = state["seed"], state.get("number", 0)
        states = state["states"]
        self._generators = None
        if states is not None:
            self._generators = [torch.Generator() for _ in states]
            for generator, value in zip(self._generators, states, strict=True):
                generator.set_state(value)

    def _draw(
        self, fill: Any, batch: torch.Size, shape: Sequence[int], mask: Tensor | None
    ) -> Tensor:
        slots: Sequence[int] = range(batch.numel())
        if self._generators is None or len(self._generators) != len(slots):
            first = int(torch.randint(_MAX_DRAWN_SEED, ())) if self._seed is None else self._seed
            stream = f"{self.stream}/{self.number}" if self.number else self.stream
            seeds = (_stream_seed(first + slot, stream) for slot in slots)
            self._generators = [torch.Generator().manual_seed(seed) for seed in seeds]
        out = torch.zeros((len(slots), *shape), dtype=torch.float32)
        if mask is not None:
            slots = mask.flatten().nonzero().flatten().tolist()
        for slot in slots:
            fill(out[slot], generator=self._generators[slot])
        return out.reshape((*batch, *shape))


class Seeded:
    """Base of a module that owns random numbers and is reached by :func:`seed_env`.

    Attributes:
        generators: What it draws from.
    """

    generators: SlotGenerators

    def seed(self, seed: int | None) -> None:
        """Start the random numbers anew from ``seed``."""
        self.generators.seed(seed)


def seed_env(env: EnvBase, seed: int) -> None:
    """Seed an environment and every transform of this project around or inside it.

    ``env.set_seed`` alone does not reach transforms in the same process. In a ``SerialEnv`` the
    environments are seeded ``seed``, ``seed + 1``, ... (one number a slot), so that it equals a
    batched environment with the same seed. The workers of a ``ParallelEnv`` cannot be reached:
    transforms in there follow ``set_seed`` if they were built with ``seed=None``. (Forked workers
    that nobody seeds share torch's state and draw the same numbers.) Transforms of one kind and the
    same entries, such as two noises of a sensor, draw unrelated numbers.

    Args:
        env: Any TorchRL environment, transformed or not.
        seed: Seed of slot 0.
    """
    _seed(env, seed)


def _seed(env: EnvBase, seed: int) -> Counter[str]:
    """Seed an environment; return how many transforms draw from each stream in it."""
    streams = Counter[str]()
    if isinstance(env, TransformedEnv):
        streams += _seed(env.base_env, seed)
        for module in env.transform.modules():
            if isinstance(module, Seeded):
                stream = module.generators.stream
                module.generators.number = streams[stream]
                module.seed(seed)
                streams[stream] += 1
    elif isinstance(env, SerialEnv):
        if env.is_closed:
            env.start()
        for child in env._envs:
            streams |= _seed(child, seed)
            seed += max(child.batch_size.numel(), 1)
    else:
        env.set_seed(seed)
    return streams


def _check_seed(seed: int | None) -> int | None:
    if seed is None:
        return None
    if isinstance(seed, bool) or not hasattr(seed, "__index__"):
        raise TypeError(f"seed: expected an integer or None, got {seed!r}")
    return operator.index(seed)


def _stream_seed(seed: int, stream: str) -> int:
    if not stream:
        return seed
    # torch's CPU generator keeps 32 bits of its seed, so the stream is hashed into them.
    digest = hashlib.blake2b(f"{stream}/{seed}".encode(), digest_size=4).digest()
    return int.from_bytes(digest, "little")
