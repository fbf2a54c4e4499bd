"""What frozen episodes came to, and a policy beside the controller alone on the same ones."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rrl.keys import METRICS, SAFETY

from ..metric import Metric
from ..metric_names import ABOVE, ACCEPTED, CONTROLLER, EPISODES, FAULTS, P99
from ..storage.files import write_atomically
from .statistics import fisher, mcnemar, wilson


@dataclass(frozen=True)
class Episodes:
    """What ``N`` episodes came to; every array is ``[N]``.

    Attributes:
        returns: Undiscounted sums of rewards.
        lengths: Numbers of control steps.
        success: Whether the last step was a success; None where the environment does not say.
        diverged: Whether the physics diverged.
        metrics: What the environment wrote under ``("metrics", NAME)``, reduced over the episode.
        limited: Numbers of steps in which each safety limit changed the action, by limit.
        declared: What the environment says of its metrics, by name: budget and limit, if any.
        cut: Whether one was cut off that the environment would have gone on with.
        faults: Numbers of attempts at each that a fault of the robot ended; None of a simulation.
    """

    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    success: NDArray[np.bool_] | None
    diverged: NDArray[np.bool_]
    metrics: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    limited: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    declared: Mapping[str, Metric] = field(default_factory=dict)
    cut: bool = False
    faults: NDArray[np.int64] | None = None

    @property
    def keeps_budgets(self) -> bool:
        """Whether the mean of every metric with a budget is within it."""
        budgets = {n: how.budget for n, how in self.declared.items() if how.budget is not None}
        return all(self.metrics[name].mean() <= budget for name, budget in budgets.items())

    def summary(self) -> dict[str, float]:
        """Return means over the episodes.

        Success comes with Wilson's 95 % interval, every metric with its 99th percentile and the
        shares of episodes above its budget and its limit, among them what is no number;
        ``safety_<limit>`` is a share of the steps. ``faults`` of a robot are counted over all
        episodes.
        """
        out = {
            "return": float(self.returns.mean()),
            "episode_length": float(self.lengths.mean()),
            "diverged": float(self.diverged.mean()),
        }
        if self.faults is not None:
            out[FAULTS] = float(self.faults.sum())
        if self.success is not None:
            low, high = wilson(int(self.success.sum()), len(self.success))
            rate = float(self.success.mean())
            out |= {"success": rate, "success_low": low, "success_high": high}
        for name, values in self.metrics.items():
            out[f"{METRICS}/{name}"] = float(values.mean())
            out[f"{METRICS}/{name}{P99}"] = float(np.percentile(values, 99))
            for kind, bound in self.declared.get(name, Metric()).bounds.items():
                out[f"{METRICS}/{name}{ABOVE[kind]}"] = float((~(values <= bound)).mean())
        steps = self.lengths.sum()
        for limit, count in self.limited.items():
            out[f"{SAFETY}_{limit}"] = float(count.sum() / steps)
        return out

    def values(self) -> dict[str, list[Any]]:
        """Return one value an episode: success, return, every metric, and a robot's faults."""
        out: dict[str, list[Any]] = {"return": self.returns.tolist()}
        if self.success is not None:
            out["success"] = self.success.tolist()
        if self.faults is not None:
            out[FAULTS] = self.faults.tolist()
        return out | {f"{METRICS}/{name}": v.tolist() for name, v in self.metrics.items()}


@dataclass(frozen=True)
class Comparison:
    """A policy and the controller alone on ``N`` episodes.

    Attributes:
        residual: The policy's episodes.
        controller: The controller's episodes, the same ones where they are frozen.
        frozen: Whether the episodes can be played again, so that they are paired; otherwise the two
            are independent samples.
        accepted: Episodes of the policy that the run would hand over, where a policy has to pass a
            test for it; None where the latest one is handed over.
        accepted_env_steps: Environment steps that it had learned from; 0: it is the controller.
    """

    residual: Episodes
    controller: Episodes
    frozen: bool = True
    accepted: Episodes | None = None
    accepted_env_steps: int = 0

    @property
    def handed_over(self) -> Comparison:
        """What the run would hand over, beside the controller."""
        return Comparison(self.accepted or self.residual, self.controller, self.frozen)

    @property
    def rescues(self) -> NDArray[np.int64]:
        """Numbers of the episodes that the controller fails and the policy solves."""
        return self._only_first(self.residual, self.controller)

    @property
    def regressions(self) -> NDArray[np.int64]:
        """Numbers of the episodes that the controller solves and the policy fails."""
        return self._only_first(self.controller, self.residual)

    def summary(self) -> dict[str, float]:
        """Return the policy's summary, the controller's under ``controller_``, and the change.

        ``frozen`` is 1 or 0; ``episodes`` is their number, which a resumed run may change. What the
        run would hand over has the policy's entries under ``accepted_``.
        """
        out = self.residual.summary()
        out |= {f"{CONTROLLER}{name}": v for name, v in self.controller.summary().items()}
        out |= self._change() | {"frozen": float(self.frozen), EPISODES: len(self.residual.returns)}
        if self.accepted is not None:
            accepted = self.accepted.summary() | self.handed_over._change()
            accepted["env_steps"] = self.accepted_env_steps
            out |= {f"{ACCEPTED}{name}": v for name, v in accepted.items()}
        return out

    def record(self) -> dict[str, dict[str, Any]]:
        """Return what ``results.json`` holds of a scenario: the summary, and every episode."""
        episodes = self.residual.values()
        for prefix, played in ((CONTROLLER, self.controller), (ACCEPTED, self.accepted)):
            if played is not None:
                episodes |= {prefix + name: values for name, values in played.values().items()}
        return {"summary": self.summary(), "episodes": episodes}

    def _change(self) -> dict[str, float]:
        """The policy against the controller: paired, or as independent samples."""
        policy, controller = self.residual, self.controller
        out = {"return_gain": float(policy.returns.mean() - controller.returns.mean())}
        if policy.success is None or controller.success is None:
            return out
        if not self.frozen:
            solved = int(policy.success.sum()), int(controller.success.sum())
            return out | {"fisher_p": fisher(*solved, len(policy.success))}
        rescues, regressions = len(self.rescues), len(self.regressions)
        return out | {
            "rescues": rescues,
            "regressions": regressions,
            "rescue_rate": rescues / len(policy.success),
            "regression_rate": regressions / len(policy.success),
            "mcnemar_p": mcnemar(rescues, regressions),
        }

    def _only_first(self, first: Episodes, second: Episodes) -> NDArray[np.int64]:
        """Numbers of the episodes that only the first one solves; none where nothing is paired."""
        if not self.frozen or first.success is None or second.success is None:
            return np.zeros(0, dtype=np.int64)
        return np.flatnonzero(first.success & ~second.success)


def write_results(results: Mapping[str, Comparison], path: Path) -> None:
    """Write every scenario's record as JSON, all or nothing."""
    content = {scenario: comparison.record() for scenario, comparison in results.items()}
    write_atomically(path, json.dumps(content, indent=1) + "\n")
