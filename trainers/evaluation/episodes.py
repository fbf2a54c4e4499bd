"""Frozen episodes without exploration, paired with the controller alone on the same episodes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from rrl.keys import ACTION, DIVERGED, SAFETY, SUCCESS
from rrl.slot_random import seed_env

from .statistics import mcnemar, wilson

PEAKS = ("contact_force", "tilt")
"""Entries whose largest value over an episode is reported, where the environment has them."""


@dataclass(frozen=True)
class Episodes:
    """What ``N`` episodes came to; every array is ``[N]``.

    Attributes:
        returns: undiscounted sum of rewards.
        lengths: number of control steps.
        success: whether the last step was a success; None where the environment does not say.
        diverged: whether the physics diverged.
        peaks: largest value of each entry of ``PEAKS`` over the episode, in the entry's units.
        limited: number of steps in which each safety limit changed the action, by the limit's name.

    """

    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    success: NDArray[np.bool_] | None
    diverged: NDArray[np.bool_]
    peaks: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    limited: dict[str, NDArray[np.int64]] = field(default_factory=dict)

    def summary(self) -> dict[str, float]:
        """Means over the episodes, with Wilson's interval of the success rate; ``safety_*`` are shares of the steps."""
        out = {
            "return": float(self.returns.mean()),
            "episode_length": float(self.lengths.mean()),
            "diverged": float(self.diverged.mean()),
        }
        if self.success is not None:
            low, high = wilson(int(self.success.sum()), len(self.success))
            out |= {
                "success": float(self.success.mean()),
                "success_low": low,
                "success_high": high,
            }
        out |= {f"peak_{name}": float(peak.mean()) for name, peak in self.peaks.items()}
        steps = self.lengths.sum()
        return out | {
            f"{SAFETY}_{name}": float(count.sum() / steps) for name, count in self.limited.items()
        }


@dataclass(frozen=True)
class Comparison:
    """A policy and the controller alone on the same ``N`` episodes."""

    residual: Episodes
    controller: Episodes

    @property
    def rescues(self) -> NDArray[np.int64]:
        """Episodes that the controller fails and the residual solves."""
        return self._changed(self.residual, self.controller)

    @property
    def regressions(self) -> NDArray[np.int64]:
        """Episodes that the controller solves and the residual fails."""
        return self._changed(self.controller, self.residual)

    @staticmethod
    def _changed(better: Episodes, worse: Episodes) -> NDArray[np.int64]:
        if better.success is None or worse.success is None:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(better.success & ~worse.success)

    def summary(self) -> dict[str, float]:
        """The residual's summary, the controller's under ``controller_``, and how they differ."""
        out = self.residual.summary()
        out |= {f"controller_{name}": value for name, value in self.controller.summary().items()}
        out["return_gain"] = float((self.residual.returns - self.controller.returns).mean())
        if self.residual.success is not None:
            rescues, regressions = len(self.rescues), len(self.regressions)
            out |= {
                "rescues": rescues,
                "regressions": regressions,
                "rescue_rate": rescues / len(self.residual.returns),
                "regression_rate": regressions / len(self.residual.returns),
                "mcnemar_p": mcnemar(rescues, regressions),
            }
        return out


def zero_residual(env: EnvBase) -> TensorDictModule:
    """The policy that leaves the controller alone: an action of zeros."""
    spec = env.full_action_spec[ACTION]
    return TensorDictModule(lambda: torch.zeros(spec.shape), in_keys=[], out_keys=[ACTION])


@torch.no_grad()
def run_episodes(
    env: EnvBase, policy: TensorDictModuleBase, num_episodes: int, seed: int, max_steps: int
) -> Episodes:
    """Run episodes ``0 .. num_episodes - 1`` of the frozen set that ``seed`` names.

    Episode ``i`` starts in the slot seeded ``seed + i``, whatever the batch size, and is the same for every policy.

    Args:
        env: environment with any batch size; its slots run episodes side by side.
        policy: from observation keys to ``action``.
        num_episodes: how many.
        seed: names the set.
        max_steps: bound on an episode's length.

    """
    slots = max(env.batch_size.numel(), 1)
    parts = []
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        for first in range(0, num_episodes, slots):
            seed_env(env, seed + first)
            parts.append(_run_batch(env, policy, max_steps))
    return _concatenate(parts, num_episodes)


def _run_batch(env: EnvBase, policy: TensorDictModuleBase, max_steps: int) -> Episodes:
    td = env.reset()
    slots = max(env.batch_size.numel(), 1)
    running = torch.ones(slots, dtype=torch.bool)
    returns = torch.zeros(slots, dtype=torch.float64)
    lengths = torch.zeros(slots, dtype=torch.int64)
    diverged = torch.zeros(slots, dtype=torch.bool)
    success = None
    peaks: dict[str, torch.Tensor] = {}
    limited: dict[str, torch.Tensor] = {}
    for _ in range(max_steps):
        td = env.step(policy(td))
        following = td["next"]
        returns += _column(following, "reward", slots).double() * running
        lengths += running
        if SUCCESS in following:
            now = _column(following, SUCCESS, slots)
            success = now if success is None else torch.where(running, now, success)
        if DIVERGED in following:
            diverged |= _column(following, DIVERGED, slots) & running
        for name in PEAKS:
            if name in following:
                value = torch.where(running, _column(following, name, slots), -torch.inf)
                peaks[name] = torch.maximum(peaks.get(name, value), value)
        for name in following.get(SAFETY, {}).keys():  # noqa: SIM118 - a TensorDict's
            limited[name] = (
                limited.get(name, 0) + (_column(following, (SAFETY, name), slots) & running).long()
            )
        running &= ~_column(following, "done", slots)
        if not running.any():
            break
        td = step_mdp(td)
    return Episodes(
        returns.numpy(),
        lengths.numpy(),
        None if success is None else success.numpy(),
        diverged.numpy(),
        {name: peak.double().numpy() for name, peak in peaks.items()},
        {name: count.numpy() for name, count in limited.items()},
    )


def _column(td: TensorDictBase, key: NestedKey, slots: int) -> torch.Tensor:
    return td[key].reshape(slots)


def _concatenate(parts: list[Episodes], count: int) -> Episodes:
    successes = [p.success for p in parts if p.success is not None]
    return Episodes(
        np.concatenate([p.returns for p in parts])[:count],
        np.concatenate([p.lengths for p in parts])[:count],
        np.concatenate(successes)[:count] if successes else None,
        np.concatenate([p.diverged for p in parts])[:count],
        {name: np.concatenate([p.peaks[name] for p in parts])[:count] for name in parts[0].peaks},
        {
            name: np.concatenate([p.limited[name] for p in parts])[:count]
            for name in parts[0].limited
        },
    )
