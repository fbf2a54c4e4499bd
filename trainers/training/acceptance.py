"""When a run hands over a new policy: it has to pass a test against the controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rrl.algorithms import Agent

from ..evaluation.episodes import Comparison, Episodes
from ..evaluation.evaluator import Evaluator
from ..evaluation.sequential import ErrorBudget, NotWorseTest, margin_unit
from ..loggers import metrics
from ..metric_names import CONTROLLER, FAULTS
from ..seeds import Stream, first_seed
from ..settings import TrainerSettings
from .run_policy import RunPolicy

SIDE_BY_SIDE = 20
"""Episodes of a batch between two looks: a much better policy needs no more."""


class Acceptance:
    """Decides what a run hands over.

    The learner's policy is a candidate if it is better, on the followed episodes, than what the run
    would hand over: by its success rate, at equal rates by whether it keeps the budgets, then by
    its return. It is taken if a sequential test on episodes that nothing else has seen shows that
    it is not worse than the controller. The test needs a bound of what can be lost in an episode:
    of returns, down to the worst that the run has seen. The error of all candidates of a run
    together is bounded; see :mod:`~rrl.trainers.evaluation.sequential`.

    Args:
        settings: The run's; without ``acceptance.enabled`` nothing is tested.
        agent: The learner.
        evaluator: Plays the episodes.

    Attributes:
        handed_over: What the run hands over.
    """

    def __init__(self, settings: TrainerSettings, agent: Agent, evaluator: Evaluator) -> None:
        self._run, self.settings = settings, settings.acceptance
        self.agent, self.evaluator = agent, evaluator
        self.handed_over = RunPolicy(agent, self.settings.enabled)
        self._first_seed = first_seed(Stream.ACCEPTANCE, settings.seed)
        self._played = 0
        self._budget = ErrorBudget(self.settings.alpha)
        self._least_return = float("inf")  # of all episodes of the run so far
        self._followed: Episodes | None = None  # of what is handed over

    @property
    def plays_again(self) -> bool:
        """Whether the next evaluation plays what is handed over once more, after a resume."""
        return self.handed_over.env_steps > 0 and self._followed is None

    def notice(self, values: Mapping[str, float]) -> None:
        """Learn from a round's metrics how badly an episode can end."""
        self._notice(values.get(metrics.LEAST_RETURN, np.nan))

    def follow(self, env_steps: int) -> tuple[Comparison, dict[str, Any]]:
        """Play the followed episodes with the learner's policy; see :meth:`consider`."""
        latest = self.evaluator.compare(
            self.agent.policy,
            self.evaluator.followed,
            Stream.FOLLOWING,
            self._run.evaluation.episodes,
        )
        comparison, tested = self.consider(latest, env_steps)
        values = comparison.summary()
        followed = metrics.evaluation(metrics.EVALUATION, self.evaluator.followed, values)
        return comparison, followed | tested

    def consider(self, comparison: Comparison, env_steps: int) -> tuple[Comparison, dict[str, Any]]:
        """Test the learner's policy if it is a candidate, and take it if it passes.

        Args:
            comparison: Of the learner's policy, on the followed episodes.
            env_steps: Environment steps that it has learned from.

        Returns:
            The comparison with what the run would hand over beside it, and metrics.
        """
        if not self.settings.enabled:
            return comparison, {}
        self._notice(*comparison.controller.returns, *comparison.residual.returns)
        unit = self._unit(comparison.controller)
        largest = max(unit, self._largest_loss(comparison.controller))
        faults: dict[str, float] = {}
        played, test = 0, self._budget.test(self.settings.margin * unit / largest)
        if self._is_candidate(comparison):
            played, faults = self._test(test, largest)
            self._budget.settle(test)
            if test.accepted:
                self.handed_over.take(env_steps)
                self._followed = comparison.residual
        values = {
            "episodes": played,
            "evidence": test.wealth * test.alpha if played else 0.0,
            "accepted": float(test.accepted),
            "alpha_left": self._budget.left,
        }
        found = (values | faults).items()
        named = {metrics.name(metrics.ACCEPTANCE, key): value for key, value in found}
        now, since = self._now(comparison), self.handed_over.env_steps
        return replace(comparison, accepted=now, accepted_env_steps=since), named

    def require_tested_on(self, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
        """Refuse to go on with a policy that was tested on another scenario than the followed one.

        Args:
            before: The configuration that a checkpoint was made with.
            now: The configuration to go on with.

        Raises:
            ValueError: If the run hands over a learned policy, and the first scenario is another.
        """
        tested, followed = map(_first_scenario, (before, now))
        if self.handed_over.env_steps and tested != followed:
            raise ValueError(
                f"env.scenarios: expected {tested} first, on which the policy was tested that the "
                f"run hands over, got {followed}; put that one first, or start a new run"
            )

    def state_dict(self) -> dict[str, Any]:
        """Return what is handed over, how many episodes are used up, and what they have shown."""
        state = {"played": self._played, "alpha_left": self._budget.left}
        state["least_return"] = self._least_return
        return self.handed_over.state_dict() | state

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        self.handed_over.load_state_dict(state)
        self._played, self._budget.left = state["played"], state["alpha_left"]
        self._least_return = state["least_return"]
        self._followed = None

    def _is_candidate(self, comparison: Comparison) -> bool:
        """Whether there is a policy that promises more than what is handed over."""
        learned = self.agent.num_updates > 0
        return learned and _score(comparison.residual) > _score(self._now(comparison))

    def _now(self, comparison: Comparison) -> Episodes:
        """The followed episodes of what is handed over; played again after a resume."""
        if self.handed_over.env_steps == 0:
            return comparison.controller
        if self._followed is None:
            self._followed = self.evaluator.play(
                self.handed_over.policy,
                self.evaluator.followed,
                Stream.FOLLOWING,
                len(comparison.residual.returns),
            )
        return self._followed

    def _test(self, test: NotWorseTest, largest: float) -> tuple[int, dict[str, float]]:
        """Play until the test is decided or the episodes are used up.

        Differences count up to ``largest``, which is 1 to the test.

        Returns:
            How many pairs, and the faults of a robot meanwhile, by whose they are.
        """
        scenario, played = self.evaluator.followed, 0
        faults: dict[str, float] = {}
        at_a_time = self.evaluator.side_by_side(scenario, SIDE_BY_SIDE)
        while not test.decided and played < self.settings.episodes:
            count = min(at_a_time, self.settings.episodes - played)
            seed = self._first_seed + self._played
            policy, alone = self.evaluator.pairs(self.agent.policy, scenario, seed, count)
            self._played, played = self._played + count, played + count
            self._notice(*policy.returns)
            for prefix, arm in (("", policy), (CONTROLLER, alone)):
                if arm.faults is not None:
                    name = prefix + FAULTS
                    faults[name] = faults.get(name, 0.0) + float(arm.faults.sum())
            test.add((_outcomes(policy) - _outcomes(alone)) / largest)
        return played, faults

    def _notice(self, *returns: float) -> None:
        finite = [float(value) for value in returns if np.isfinite(value)]
        self._least_return = min([self._least_return, *finite])

    def _largest_loss(self, controller: Episodes) -> float:
        """From the controller's best followed episode down to the worst return of the run."""
        if controller.success is not None:
            return 1.0
        finite = controller.returns[np.isfinite(controller.returns)]
        return float(finite.max(initial=self._least_return)) - self._least_return

    @staticmethod
    def _unit(controller: Episodes) -> float:
        """What the margin is a share of: a success, or the range of the controller's returns."""
        return margin_unit(controller.returns) if controller.success is None else 1.0


def _first_scenario(config: Mapping[str, Any]) -> dict[str, Any]:
    """The followed scenario by name, as far as a configuration tells."""
    env = config.get("env")
    scenarios = env.get("scenarios") if isinstance(env, Mapping) else None
    return dict(list((scenarios or {}).items())[:1])


def _outcomes(episodes: Episodes) -> NDArray[np.float64]:
    found = episodes.returns if episodes.success is None else episodes.success
    return found.astype(np.float64)


def _score(episodes: Episodes) -> tuple[float, bool, float]:
    """Success rate, then whether budgets are kept, then return; no number is the worst."""
    rate = 0.0 if episodes.success is None else float(episodes.success.mean())
    mean = float(episodes.returns.mean())
    return rate, episodes.keeps_budgets, mean if np.isfinite(mean) else -np.inf
