"""Play frozen episodes: the one loop of evaluation, videos and recorded sequences."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import TypeVar

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from rrl.keys import ACTION, DIVERGED, METRICS, REWARD, SAFETY, SUCCESS
from rrl.robot import RobotFault
from rrl.slot_random import seed_env

from ..generators import isolated_generators
from ..metric import Metric
from ..requests import stand_still, stop_of
from ..resumable_env import ResumableEnv
from .episodes import Episodes

log = logging.getLogger(__name__)

T = TypeVar("T")
RETRY = 1.0
"""Seconds between attempts to play an episode on a robot that does not do what it should."""
ATTEMPTS = 3
"""How often an episode is played that faults of the robot end: by then it has failed."""


class _CutShort(Exception):
    """An episode that is not whole: it cannot be judged by what there is of it."""


def zero_residual(env: EnvBase) -> TensorDictModule:
    """Return the policy that leaves the controller alone: an action of zeros."""
    spec = env.full_action_spec[ACTION]
    return TensorDictModule(lambda: torch.zeros(spec.shape), in_keys=[], out_keys=[ACTION])


def rollout(
    env: EnvBase, policy: TensorDictModuleBase, seed: int, max_steps: int, episodes: int = 0
) -> Iterator[tuple[TensorDictBase, Tensor]]:
    """Play one episode in every slot, without exploration. A robot stands still afterwards.

    Use it inside :func:`~rrl.trainers.generators.isolated_generators`.

    Args:
        env: An environment with any batch size.
        policy: From observation keys to ``action``.
        seed: Seed of slot 0; slot ``i`` has ``seed + i``.
        max_steps: Bound on an episode's length.
        episodes: How many slots count, from the first one on; 0 stands for all.

    Yields:
        What the reset gave, then what every step led to, with its ``action``, ``reward`` and
        ``done``; beside it the slots whose episode had not ended before that step, bool
        ``[slots]``.
    """
    slots = max(env.batch_size.numel(), 1)
    running = torch.arange(slots) < (episodes or slots)
    try:
        with torch.no_grad():
            seed_env(env, seed)
            td = env.reset()
        yield td, running
        for _ in range(max_steps):
            with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
                td = step_mdp(
                    env.step(policy(env.maybe_reset(td))),  # some refuse to step beyond an end
                    exclude_reward=False,
                    exclude_done=False,
                    exclude_action=False,
                )
            if isinstance(env, ResumableEnv) and env.is_cut_short:
                raise _CutShort("a pause has stopped the robot")
            yield td, running
            running = running & ~td["done"].reshape(slots)
            if not running.any():
                return
    finally:
        stand_still(env)


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
    every policy. One that a fault of the robot ends in each of its :data:`ATTEMPTS` has failed: it
    is no success, its return is not a number, and its quantities are those of the last attempt.

    Args:
        env: An environment with any batch size; its slots run episodes side by side.
        policy: From observation keys to ``action``.
        num_episodes: How many.
        seed: Seed of the first episode.
        max_steps: Bound on an episode's length.
        metrics: How what the environment writes is reduced, and its budget and limit; names that
            are missing get the mean.
    """
    slots = max(env.batch_size.numel(), 1)
    parts, cut = [], False
    for first in range(0, num_episodes, slots):
        kept = min(slots, num_episodes - first)
        play = partial(rollout, env, policy, seed + first, max_steps, kept)
        with isolated_generators(seed + first):
            played, faults = whole(env, play)
        steps = played[1:] or played  # a fault in the first step leaves the reset alone
        last, mask = steps[-1]
        running = np.stack([mask[:kept].numpy() for _, mask in steps])  # (T, kept)
        part = _reduced([_entries(td, kept) for td, _ in steps], running, metrics or {})
        if faults == ATTEMPTS:
            part[REWARD] = np.full(kept, np.nan)
            part |= {SUCCESS: np.zeros(kept)} if SUCCESS in part else {}
        else:
            cut |= bool((mask & ~last["done"].reshape(slots))[:kept].any())
        parts.append(part | {"faults": np.full(kept, faults)})
    columns = _joined(parts)

    def named(group: str) -> dict[str, np.ndarray]:
        found = [key for key in columns if key.startswith(f"{group}/")]
        return {key.partition("/")[2]: columns[key] for key in found}

    return Episodes(
        columns[REWARD],
        columns["length"].astype(np.int64),
        columns[SUCCESS].astype(bool) if SUCCESS in columns else None,
        columns.get(DIVERGED, np.zeros(num_episodes)).astype(bool),
        named(METRICS),
        {limit: count.astype(np.int64) for limit, count in named(SAFETY).items()},
        metrics or {},
        cut,
        columns["faults"] if stop_of(env) is not None else None,
    )


def whole(env: EnvBase, play: Callable[[], Iterable[T]]) -> tuple[list[T], int]:
    """Return what ``play`` gives; it is called again where a fault or a pause cuts it short.

    A fault before the first thing that ``play`` gives is of a robot that is not there: it is waited
    for. Later ones may be the policy's doing: after :data:`ATTEMPTS` of them that is it.

    Returns:
        What ``play`` gave, up to the last fault where that ended it, and how many faults it met.

    Raises:
        Exception: What :attr:`Requests.check` raises if the run is to end: it is not called again.
    """
    faults = 0
    while True:
        given: list[T] = []
        try:
            for each in play():
                given.append(each)
            return given, faults
        except (RobotFault, _CutShort) as reason:
            faults += bool(given) and isinstance(reason, RobotFault)
            failed = faults == ATTEMPTS
            what = "counts as failed" if failed else "is played again"
            log.warning("an evaluation's episode %s: %s", what, reason)
        time.sleep(RETRY)
        if isinstance(env, ResumableEnv) and env.requests is not None:
            env.requests.check()
        if failed:
            return given, faults


def _joined(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Join the columns; a quantity that a part lacks, as it was never measured, is not a number."""
    columns = {}
    for key in dict.fromkeys(key for part in parts for key in part):
        lacking = np.nan if key.startswith(f"{METRICS}/") else 0.0
        found = [part.get(key, np.full(len(part["length"]), lacking)) for part in parts]
        columns[key] = np.concatenate(found)
    return columns


def _entries(td: TensorDictBase, kept: int) -> dict[str, np.ndarray]:
    """What a step reports of the first ``kept`` slots, float64 ``[kept]``, by name."""
    found = td.select(REWARD, SUCCESS, DIVERGED, METRICS, SAFETY, strict=False).flatten_keys("/")
    return {key: value.flatten()[:kept].double().numpy() for key, value in found.items()}


def _reduced(
    steps: list[dict[str, np.ndarray]], running: np.ndarray, metrics: Mapping[str, Metric]
) -> dict[str, np.ndarray]:
    """Every entry reduced over the running steps of each episode, and the episodes' ``length``."""
    length = running.sum(axis=0)
    out = {"length": length}
    how = {REWARD: "sum", SUCCESS: "last", DIVERGED: "max"}
    for key in steps[0]:
        group, _, name = key.partition("/")
        declared = metrics.get(name, Metric()).reduce if group == METRICS else "sum"
        reduction, values = how.get(key, declared), np.stack([step[key] for step in steps])
        if reduction == "last":
            out[key] = values[length - 1, np.arange(len(length))]
        elif reduction in ("max", "min"):
            worst = -np.inf if reduction == "max" else np.inf
            out[key] = getattr(np.where(running, values, worst), reduction)(axis=0)
        else:
            total = np.where(running, values, 0.0).sum(axis=0)
            out[key] = total / length if reduction == "mean" else total
    return out
