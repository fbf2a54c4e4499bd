"""Play frozen episodes: the one loop of evaluation, videos and recorded sequences."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from rrl.keys import ACTION, DIVERGED, METRICS, REWARD, SAFETY, SUCCESS
from rrl.slot_random import seed_env

from ..environment import Metric
from .episodes import Episodes

__all__ = ["isolated_generators", "rollout", "run_episodes", "zero_residual"]


def zero_residual(env: EnvBase) -> TensorDictModule:
    """Return the policy that leaves the controller alone: an action of zeros."""
    spec = env.full_action_spec[ACTION]
    return TensorDictModule(lambda: torch.zeros(spec.shape), in_keys=[], out_keys=[ACTION])


@contextmanager
def isolated_generators(seed: int) -> Iterator[None]:
    """Seed the global generators of Python, NumPy and torch, and put them back afterwards.

    Learning goes on as if nothing had been played, and an environment that draws from a global
    generator draws the same for every policy.
    """
    python, legacy = random.getstate(), np.random.get_state()  # noqa: NPY002 - the global one
    with torch.random.fork_rng(devices=[]):
        random.seed(seed)
        np.random.seed(seed)  # noqa: NPY002
        torch.default_generator.manual_seed(seed)
        try:
            yield
        finally:
            random.setstate(python)
            np.random.set_state(legacy)  # noqa: NPY002


def rollout(
    env: EnvBase, policy: TensorDictModuleBase, seed: int, max_steps: int, episodes: int = 0
) -> Iterator[tuple[TensorDictBase, Tensor]]:
    """Play one episode in every slot, without exploration.

    Use it inside :func:`isolated_generators`.

    Args:
        env: An environment with any batch size.
        policy: From observation keys to ``action``.
        seed: Seed of slot 0; slot ``i`` has ``seed + i``.
        max_steps: Bound on an episode's length.
        episodes: How many slots count, from the first one on; 0 stands for all.

    Yields:
        What the reset gave, then what every step led to, with its ``action``, ``reward`` and
        ``done``; beside it the slots whose episode had not ended before that step, bool ``[slots]``.
    """
    slots = max(env.batch_size.numel(), 1)
    running = torch.arange(slots) < (episodes or slots)
    with torch.no_grad():
        seed_env(env, seed)
        td = env.reset()
    yield td, running
    for _ in range(max_steps):
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            td = step_mdp(
                env.step(policy(td)),
                exclude_reward=False,
                exclude_done=False,
                exclude_action=False,
            )
        yield td, running
        running = running & ~td["done"].reshape(slots)
        if not running.any():
            return


def run_episodes(
    env: EnvBase,
    policy: TensorDictModuleBase,
    num_episodes: int,
    seed: int,
    max_steps: int,
    metrics: Mapping[str, Metric] | None = None,
) -> Episodes:
    """Play episodes ``0 .. num_episodes - 1`` of the frozen set that starts at ``seed``.

    Episode ``i`` starts in a slot seeded ``seed + i`` whatever the batch size, and is the same for
    every policy.

    Args:
        env: An environment with any batch size; its slots run episodes side by side.
        policy: From observation keys to ``action``.
        num_episodes: How many.
        seed: Seed of the first episode.
        max_steps: Bound on an episode's length.
        metrics: How what the environment writes is reduced; names that are missing get the mean.
    """
    slots = max(env.batch_size.numel(), 1)
    batches = []
    for first in range(0, num_episodes, slots):
        kept = min(slots, num_episodes - first)
        tally = _Tally(slots, metrics or {})
        with isolated_generators(seed + first):
            steps = rollout(env, policy, seed + first, max_steps, kept)
            next(steps)  # the reset
            for td, running in steps:
                tally.add(td, running)
        batches.append(tally.columns(kept))
    columns = {key: np.concatenate([batch[key] for batch in batches]) for key in batches[0]}

    def group(name: str) -> dict[str, np.ndarray]:
        return {key[1]: values for key, values in columns.items() if key[0] == name}

    plain = group("")
    return Episodes(
        plain["return"],
        plain["length"],
        plain.get(SUCCESS),
        plain[DIVERGED],
        group(METRICS),
        group(SAFETY),
    )


class _Tally:
    """Sums, last values and extremes of a batch of episodes, each ``[slots]``."""

    def __init__(self, slots: int, metrics: Mapping[str, Metric]) -> None:
        self._slots, self._metrics = slots, metrics
        self._columns: dict[tuple[str, str], Tensor] = {
            ("", "return"): torch.zeros(slots, dtype=torch.float64),
            ("", "length"): torch.zeros(slots, dtype=torch.int64),
            ("", DIVERGED): torch.zeros(slots, dtype=torch.bool),
        }

    def add(self, td: TensorDictBase, running: Tensor) -> None:
        """Add one step of the episodes that are still running."""

        def flat(value: Tensor) -> Tensor:
            return value.reshape(self._slots)

        self._put(("", "return"), "sum", flat(td[REWARD]).double(), running)
        self._put(("", "length"), "sum", torch.ones_like(running).long(), running)
        if SUCCESS in td:
            self._put(("", SUCCESS), "last", flat(td[SUCCESS]).bool(), running)
        if DIVERGED in td:
            self._put(("", DIVERGED), "max", flat(td[DIVERGED]).bool(), running)
        for limit, changed in td.get(SAFETY, {}).items():
            self._put((SAFETY, limit), "sum", flat(changed).bool().long(), running)
        for name, value in td.get(METRICS, {}).items():
            self._put((METRICS, name), self._reduction(name), flat(value).double(), running)

    def columns(self, kept: int) -> dict[tuple[str, str], np.ndarray]:
        """Return one value for each of the first ``kept`` episodes."""
        lengths = self._columns["", "length"]
        means = [k for k in self._columns if k[0] == METRICS and self._reduction(k[1]) == "mean"]
        columns = self._columns | {key: self._columns[key] / lengths for key in means}
        return {key: values[:kept].numpy() for key, values in columns.items()}

    def _reduction(self, name: str) -> str:
        return self._metrics.get(name, Metric()).reduce

    def _put(self, key: tuple[str, str], reduction: str, value: Tensor, running: Tensor) -> None:
        old = self._columns.get(key)
        if old is None:
            new = value
        elif reduction in ("sum", "mean"):
            new = old + value
        elif reduction == "last":
            new = value
        else:
            new = torch.maximum(old, value) if reduction == "max" else torch.minimum(old, value)
        self._columns[key] = new if old is None else torch.where(running, new, old)
