"""What one collection says about behaviour: reward, success, and how controller and residual share the work."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from rrl.keys import ACTION, BASE_ACTION, DIVERGED, REWARD_TERMS, SAFETY, SUCCESS
from rrl.transforms import ResidualAction

from ..loggers import metrics


def experience_metrics(
    data: TensorDictBase, num_seeds: int, env: TransformedEnv
) -> dict[str, list[float]]:
    """Metrics of collected data ``[S * E, T]``, one value per seed.

    ``train/reward`` and ``train/reward_terms/*`` are means over steps; ``train/success`` is the share of the episodes
    that ended in this collection, absent if none did; ``train/diverged`` counts the episodes that physics failed in.
    """
    data = data.reshape(num_seeds, -1)
    following = data["next"]
    values = {metrics.name(metrics.TRAIN, "reward"): _mean(following["reward"])}
    terms = following.get(REWARD_TERMS, None)
    for term, value in () if terms is None else terms.items():
        values[metrics.name(metrics.TRAIN, REWARD_TERMS, term)] = _mean(value)
    ended = following["done"].flatten(1)
    if SUCCESS in following and ended.any(-1).all():
        solved = (following[SUCCESS].flatten(1) & ended).sum(-1) / ended.sum(-1)
        values[metrics.name(metrics.TRAIN, "success")] = solved.tolist()
    if DIVERGED in following:
        values[metrics.name(metrics.TRAIN, DIVERGED)] = (
            following[DIVERGED].flatten(1).sum(-1).tolist()
        )
    for limit, changed in following.get(SAFETY, {}).items():
        values[metrics.name(metrics.SAFETY, limit)] = _mean(changed)
    return values | _shares(data, env)


def _shares(data: TensorDictBase, env: TransformedEnv) -> dict[str, list[float]]:
    residual_action = next(t for t in env.transform if isinstance(t, ResidualAction))
    limits = residual_action.limits()
    low, high, half_range = (
        x.reshape(-1, x.shape[-1])[0] for x in (limits.low, limits.high, limits.half_range)
    )
    residual = residual_action.scale * half_range * data[ACTION]
    base = data[BASE_ACTION]
    demand = base + residual
    clipped = (demand < low) | (demand > high)
    size, base_size = residual.abs().mean((-1, -2)), base.abs().mean((-1, -2))
    return {
        metrics.name(metrics.ACTION, "residual_rms"): residual.square()
        .mean((-1, -2))
        .sqrt()
        .tolist(),
        metrics.name(metrics.ACTION, "residual_share"): (
            size / (size + base_size).clamp_min(1e-9)
        ).tolist(),
        metrics.name(metrics.ACTION, "clip_fraction"): _mean(clipped),
    }


def _mean(x: Tensor) -> list[float]:
    return x.to(torch.float32).flatten(1).mean(-1).tolist()
