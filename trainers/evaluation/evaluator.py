"""Evaluates stacked policies on named scenarios, with the controller's episodes run once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torchrl.envs import EnvBase

from ..environment import EnvironmentFactory
from ..settings import EvaluationSettings
from .episodes import Comparison, Episodes, run_episodes, zero_residual


class Evaluator:
    """Pairs policies with the controller alone on frozen episodes.

    Args:
        scenarios: environments by name; the first is followed during training.
        settings: how many episodes, and which.

    """

    def __init__(
        self, scenarios: Mapping[str, EnvironmentFactory], settings: EvaluationSettings
    ) -> None:
        if not scenarios:
            raise ValueError("expected at least one scenario to evaluate on")
        self.scenarios, self.settings = dict(scenarios), settings
        self._envs: dict[str, EnvBase] = {}
        self._controller: dict[tuple[str, int], Episodes] = {}

    def during_training(self, agent: Any, num_seeds: int) -> tuple[str, list[Comparison]]:
        """Evaluate every seed's policy on the first scenario."""
        scenario = next(iter(self.scenarios))
        return scenario, self.compare(agent, num_seeds, scenario, self.settings.episodes)

    def compare(self, agent: Any, num_seeds: int, scenario: str, episodes: int) -> list[Comparison]:
        """One comparison with the controller per seed."""
        controller = self.controller(scenario, episodes)
        return [
            Comparison(self._run(agent.policy_of(k), scenario, episodes), controller)
            for k in range(num_seeds)
        ]

    def controller(self, scenario: str, episodes: int) -> Episodes:
        """The controller alone, run once for each scenario and number of episodes."""
        key = scenario, episodes
        if key not in self._controller:
            self._controller[key] = self._run(zero_residual(self._env(scenario)), *key)
        return self._controller[key]

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs.values():
            env.close()

    def _run(self, policy: Any, scenario: str, episodes: int) -> Episodes:
        max_steps = self.scenarios[scenario].max_episode_steps
        return run_episodes(self._env(scenario), policy, episodes, self.settings.seed, max_steps)

    def _env(self, scenario: str) -> EnvBase:
        if scenario not in self._envs:
            factory = self.scenarios[scenario]
            slots = self.settings.slots if factory.batching == "native" else 1
            self._envs[scenario] = factory.make(slots)
        return self._envs[scenario]
