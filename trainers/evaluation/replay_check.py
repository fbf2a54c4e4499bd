"""Are frozen episodes frozen? The controller's first ones are played twice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from ..generators import isolated_generators
from .rollout import rollout, whole

FEW = 3
"""How many episodes are played twice."""
NOT_FROZEN = (
    "%s: the same frozen episodes came out differently when the controller played them twice (%s). "
    "Seeded before each of them: the environment, by its set_seed, and the global generators of "
    "Python's random, of NumPy and of torch%s. Policy and controller are therefore compared as "
    "independent samples: without rescued and broken episodes and McNemar's test, and with wider "
    "intervals. To pair them, let the environment draw everything from a generator that its "
    "set_seed seeds."
)
"""What is logged of a scenario whose episodes are not frozen: its name, where they differ, and who
shares the generators."""
Trace = Sequence[tuple[Mapping[NestedKey, NDArray[np.float64]], NDArray[np.bool_]]]
"""Of every step one number for each entry and slot, ``[slots]``, and the slots that still run."""


def replay_difference(
    env: EnvBase, policy: TensorDictModuleBase, seed: int, max_steps: int
) -> str | None:
    """Play the first episodes of a frozen set twice.

    One slot plays them again in the opposite order: what an environment keeps from one episode to
    the next does not come back by chance. The slots of a batch play theirs side by side again.

    Args:
        env: An environment with any batch size.
        policy: From observation keys to ``action``; it draws no random numbers.
        seed: Seed of the first episode.
        max_steps: Bound on an episode's length.

    Returns:
        Where an episode first differs, in words; None if none does.
    """
    slots = max(env.batch_size.numel(), 1)
    seeds = range(seed, seed + FEW) if slots == 1 else range(seed, seed + 1)
    first = {each: _trace(env, policy, each, max_steps) for each in seeds}
    for each in reversed(seeds):
        found = _first_difference(first[each], _trace(env, policy, each, max_steps))
        if found is not None:
            step, slot, entry = found
            place = f"from step {step} on" if step else "from its start on"
            return f"episode {each - seed + slot} differs {place}, in {entry!r}"
    return None


def _trace(env: EnvBase, policy: TensorDictModuleBase, seed: int, max_steps: int) -> Trace:
    with isolated_generators(seed):
        return whole(
            env,
            lambda: (
                (_checksums(td, len(running)), running.numpy())
                for td, running in rollout(env, policy, seed, max_steps, FEW)
            ),
        )[0]


def _checksums(td: TensorDictBase, slots: int) -> dict[NestedKey, NDArray[np.float64]]:
    """Return a weighted mean of every tensor, ``[slots]``: images would fill the memory."""
    found: dict[NestedKey, NDArray[np.float64]] = {}
    for key, value in td.items(True, True):  # text is not among them
        rows = value.reshape(slots, -1).double()
        weights = torch.linspace(1, 2, rows.shape[1], dtype=torch.float64)
        found[key] = ((rows * weights).sum(-1) / weights.sum()).numpy()
    return found


def _first_difference(first: Trace, second: Trace) -> tuple[int, int, NestedKey] | None:
    """Return step, slot and entry of the first difference beyond rounding."""
    for step, ((before, running), (again, runs)) in enumerate(zip(first, second, strict=False)):
        for entry, values in before.items():
            other = again.get(entry, np.full_like(values, np.nan))
            same = np.isclose(values, other, rtol=1e-5, atol=1e-8, equal_nan=True)
            if len(wrong := np.flatnonzero(running & (~same | ~runs))):
                return step, int(wrong[0]), entry
    return None
