"""What a collection tells: reward, success, and how controller and residual share the work."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from rrl.keys import ACTION, BASE_ACTION, DIVERGED, INTERVENTION, REWARD_TERMS, SAFETY, SUCCESS
from rrl.transforms import ResidualAction

from ..loggers import metrics


class EpisodeReturns:
    """Undiscounted returns of the exploring policy's episodes, which may span collections.

    Attributes:
        running: Sum of rewards of each episode in progress, ``[E]``.
    """

    def __init__(self, num_envs: int) -> None:
        self.running = torch.zeros(num_envs, dtype=torch.float64)

    def reset(self) -> None:
        """Begin new episodes."""
        self.running = torch.zeros_like(self.running)

    def metrics(self, data: TensorDictBase) -> dict[str, float]:
        """Return mean and least return of the episodes that end in ``data`` [E, T], if any do."""
        rewards = data["next", "reward"].reshape(*data.shape, -1).double().sum(-1)
        done = data["next", "done"].reshape(*data.shape, -1).any(-1)
        ended: list[Tensor] = []
        for reward, over in zip(rewards.unbind(1), done.unbind(1), strict=True):
            self.running = self.running + reward
            ended.append(self.running[over])
            self.running = torch.where(over, 0.0, self.running)
        returns = torch.cat(ended)
        if not len(returns):
            return {}
        mean = metrics.name(metrics.TRAIN, "return")
        return {mean: float(returns.mean()), metrics.LEAST_RETURN: float(returns.min())}


@dataclass(frozen=True)
class Authority:
    """What the residual can do to the executed action, numbers ``[n]`` of the action's units.

    Attributes:
        low: Smallest executed action.
        high: Largest executed action.
        span: What a residual of 1 adds.
    """

    low: Tensor
    high: Tensor
    span: Tensor

    @classmethod
    def of(cls, env: TransformedEnv) -> Authority:
        """Read it from the environment's :class:`~rrl.ResidualAction`."""
        residual_action = next(t for t in env.transform if isinstance(t, ResidualAction))
        limits = residual_action.limits()
        low, high, half_range = (
            x.reshape(-1, x.shape[-1])[0] for x in (limits.low, limits.high, limits.half_range)
        )
        return cls(low, high, (residual_action.scale * half_range).to(low.dtype))


def collection_metrics(data: TensorDictBase, authority: Authority) -> dict[str, float]:
    """Return metrics of collected data ``[E, T]``.

    ``train/reward`` and ``train/reward_terms/*`` are means over steps; ``train/success`` is the
    share of the episodes that ended in this collection, absent if none did; ``train/diverged``
    counts the episodes that physics failed in.
    """
    following = data["next"]
    values = {metrics.name(metrics.TRAIN, "reward"): _mean(following["reward"])}
    terms = following.get(REWARD_TERMS, None)
    for term, value in () if terms is None else terms.items():
        values[metrics.name(metrics.TRAIN, REWARD_TERMS, term)] = _mean(value)
    ended = following["done"].flatten()
    if SUCCESS in following and ended.any():
        solved = following[SUCCESS].flatten().bool() & ended
        values[metrics.name(metrics.TRAIN, "success")] = float(solved.sum() / ended.sum())
    if DIVERGED in following:
        values[metrics.name(metrics.TRAIN, DIVERGED)] = float(following[DIVERGED].sum())
    if (told := following.get(INTERVENTION, None)) is not None:
        values[metrics.name(metrics.INTERVENTION, "steps")] = _mean(told["active"])
        values[metrics.name(metrics.INTERVENTION, "exceeds")] = _mean(told["exceeds"])
    for limit, changed in following.get(SAFETY, {}).items():
        values[metrics.name(metrics.SAFETY, limit)] = _mean(changed)
    return values | _shares(data, authority)


def _shares(data: TensorDictBase, authority: Authority) -> dict[str, float]:
    residual = authority.span * data[ACTION]
    base = data[BASE_ACTION]
    clipped = (base + residual < authority.low) | (base + residual > authority.high)
    size, base_size = residual.abs().mean(), base.abs().mean()
    return {
        metrics.name(metrics.ACTION, "residual_rms"): float(residual.square().mean().sqrt()),
        metrics.name(metrics.ACTION, "residual_share"): float(
            size / (size + base_size).clamp_min(1e-9)
        ),
        metrics.name(metrics.ACTION, "clip_fraction"): _mean(clipped),
    }


def _mean(x: Tensor) -> float:
    return float(x.to(torch.float32).mean())
