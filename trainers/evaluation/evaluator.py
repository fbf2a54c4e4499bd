"""Evaluate policies on named scenarios; the controller plays each set of episodes once."""

from __future__ import annotations

from collections.abc import Mapping

from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from ..environment import EnvironmentFactory
from ..seeds import Stream, first_seed
from ..settings import EvaluationSettings
from .episodes import Comparison, Episodes
from .rollout import run_episodes, zero_residual

__all__ = ["Evaluator"]


class Evaluator:
    """Pairs a policy with the controller alone on frozen episodes.

    Args:
        scenarios: Environments by name; the first is followed during training.
        settings: How many episodes, and which.

    Raises:
        ValueError: If there is no scenario.
    """

    def __init__(
        self, scenarios: Mapping[str, EnvironmentFactory], settings: EvaluationSettings
    ) -> None:
        if not scenarios:
            raise ValueError("scenarios: expected at least one, got none")
        self.scenarios, self.settings = dict(scenarios), settings
        self._envs: dict[tuple[str, int], EnvBase] = {}
        self._controller: dict[tuple[str, Stream, int], Episodes] = {}

    @property
    def followed(self) -> str:
        """The scenario that is evaluated during training."""
        return next(iter(self.scenarios))

    def compare(
        self, policy: TensorDictModuleBase, scenario: str, stream: Stream, episodes: int
    ) -> Comparison:
        """Compare a policy with the controller alone on the first episodes of a stream."""
        key = scenario, stream, episodes
        if key not in self._controller:
            alone = zero_residual(self._env(scenario, episodes))
            self._controller[key] = self._play(alone, *key)
        return Comparison(self._play(policy, *key), self._controller[key])

    def first_seed(self, stream: Stream) -> int:
        """Return the seed of a stream's first episode; episode ``i`` has this seed plus ``i``."""
        return first_seed(stream, self.settings.seed)

    def close(self) -> None:
        """Close the environments."""
        while self._envs:
            self._envs.popitem()[1].close()

    def _play(
        self, policy: TensorDictModuleBase, scenario: str, stream: Stream, episodes: int
    ) -> Episodes:
        factory = self.scenarios[scenario]
        return run_episodes(
            self._env(scenario, episodes),
            policy,
            episodes,
            self.first_seed(stream),
            factory.max_episode_steps,
            factory.metrics,
        )

    def _env(self, scenario: str, episodes: int) -> EnvBase:
        """The scenario's environment, with equal batches that no slot is played in vain for."""
        factory, slots = self.scenarios[scenario], 1
        if factory.batching == "native":
            batches = -(-episodes // self.settings.slots)
            slots = -(-episodes // batches)
        if (scenario, slots) not in self._envs:
            self._envs[scenario, slots] = factory.make(slots)
        return self._envs[scenario, slots]
