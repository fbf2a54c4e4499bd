"""Evaluate policies on named scenarios; the controller plays each set of episodes once."""

from __future__ import annotations

import logging
from collections.abc import Mapping

from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from ..environment import EnvironmentFactory
from ..generators import isolated_generators
from ..requests import Requests, stop_of
from ..resumable_env import ResumableEnv
from ..seeds import Stream, first_seed
from ..settings import EvaluationSettings
from .episodes import Comparison, Episodes
from .replay_check import FEW, NOT_FROZEN, replay_difference
from .rollout import run_episodes, zero_residual

log = logging.getLogger(__name__)

BY_RETURN = (
    "%s: the environment writes no `success`; policies are compared by their return. To have them "
    "compared by success, let its steps write `success` ([1], bool)"
)
"""What is logged of a scenario without success: its name."""


class Evaluator:
    """Plays a policy and the controller alone on frozen episodes.

    Whether a scenario's episodes are frozen is tried before its first comparison: see
    :mod:`.replay_check`. Where they are not, the two are independent samples.

    Args:
        scenarios: Environments by name; the first is followed during training.
        settings: How many episodes, and which.
        requests: What a person asks for while they are played.

    Raises:
        ValueError: If there is no scenario.
    """

    def __init__(
        self,
        scenarios: Mapping[str, EnvironmentFactory],
        settings: EvaluationSettings,
        requests: Requests | None = None,
    ) -> None:
        if not scenarios:
            raise ValueError("scenarios: expected at least one, got none")
        self.scenarios, self.settings = dict(scenarios), settings
        self._requests = requests or Requests()
        self._envs: dict[tuple[str, int], ResumableEnv] = {}
        self._controller: dict[tuple[str, Stream, int], Episodes] = {}
        self._frozen: dict[str, bool] = {}
        self._by_return: set[str] = set()  # scenarios of which it was said
        self._compared = False  # whether a wrong limit was named

    @property
    def followed(self) -> str:
        """The scenario that is evaluated during training."""
        return next(iter(self.scenarios))

    def compare(
        self, policy: TensorDictModuleBase, scenario: str, stream: Stream, episodes: int
    ) -> Comparison:
        """Compare a policy with the controller alone on the first episodes of a stream."""
        frozen = self.is_frozen(scenario)
        alone = self.controller(scenario, stream, episodes)
        return Comparison(self.play(policy, scenario, stream, episodes), alone, frozen)

    def controller(self, scenario: str, stream: Stream, episodes: int) -> Episodes:
        """Return what the controller alone comes to on the first episodes of a stream."""
        key = scenario, stream, episodes
        if key not in self._controller:
            alone = zero_residual(self._env(scenario, episodes))
            self._controller[key] = played = self.play(alone, *key)
            self._compare_limit(scenario, played)
            if played.success is None and scenario not in self._by_return:
                self._by_return.add(scenario)
                log.info(BY_RETURN, scenario)
        return self._controller[key]

    def play(
        self, policy: TensorDictModuleBase, scenario: str, stream: Stream, episodes: int
    ) -> Episodes:
        """Play the first episodes of a stream."""
        return self._play(policy, scenario, self.first_seed(stream), episodes)

    def pairs(
        self, policy: TensorDictModuleBase, scenario: str, seed: int, episodes: int
    ) -> tuple[Episodes, Episodes]:
        """Play policy and controller alone on episodes of which nothing is remembered.

        Args:
            policy: From observation keys to ``action``.
            scenario: Name of the scenario.
            seed: Seed of the first episode.
            episodes: How many, each by both; :meth:`side_by_side` of them at a time are quickest.
        """
        alone = zero_residual(self._env(scenario, episodes))
        return (
            self._play(policy, scenario, seed, episodes),
            self._play(alone, scenario, seed, episodes),
        )

    def try_out(self) -> None:
        """Play a step of every simulated scenario: what is wrong with one is found before training.

        Raises:
            RuntimeError: If one cannot be played; the message names it.
        """
        for scenario, factory in self.scenarios.items():
            try:
                env = self._env(scenario, FEW)
                if stop_of(env) is None:
                    run_episodes(env, zero_residual(env), 1, 0, 1, factory.metrics)
            except Exception as error:
                self._requests.check()  # raises where the run is to end
                raise RuntimeError(f"scenario {scenario}: {error}") from error

    def side_by_side(self, scenario: str, at_most: int) -> int:
        """Return how many episodes of a scenario are played at a time."""
        native = self.scenarios[scenario].batching == "native"
        return min(at_most, self.settings.slots) if native else 1

    def is_frozen(self, scenario: str) -> bool:
        """Return whether a scenario's episodes can be played again; log once if they cannot."""
        if scenario not in self._frozen:
            env, most = self._env(scenario, FEW), self.scenarios[scenario].max_episode_steps
            first = self.first_seed(Stream.FOLLOWING)
            difference = replay_difference(env, zero_residual(env), first, most)
            self._frozen[scenario] = difference is None
            if difference is not None:
                several = env.batch_size.numel() > 1
                shared = ", which all slots of a batch share" if several else ""
                log.warning(NOT_FROZEN, scenario, difference, shared)
        return self._frozen[scenario]

    def first_seed(self, stream: Stream) -> int:
        """Return the seed of a stream's first episode; episode ``i`` has this seed plus ``i``."""
        return first_seed(stream, self.settings.seed)

    def lap(self) -> dict[str, float]:
        """Return the seconds of steps and of resets since the last time, by name."""
        laps = [env.lap() for env in self._envs.values()]
        return {part: sum(lap.get(part, 0.0) for lap in laps) for part in ("robot", "reset")}

    def close(self) -> None:
        """Close the environments."""
        while self._envs:
            self._envs.popitem()[1].close()

    def _compare_limit(self, scenario: str, played: Episodes) -> None:
        """Say once if the episodes have another length than the one that settings derive from."""
        limit, lengths = self.scenarios[scenario].max_episode_steps, played.lengths
        together = len(lengths) > 1 and lengths.min() == lengths.max() < limit
        if self._compared or not (together or played.cut):
            return
        self._compared = True
        found = (
            "episodes that the environment would go on with are cut off in evaluations, and not in "
            "training; raise the limit, or let the environment end them"
            if played.cut
            else f"all {len(lengths)} episodes of the controller ended after {lengths[0]} steps"
        )
        log.warning(
            "max_episode_steps: expected the length of an episode, from which discount, warm-up "
            "and the price of the residual are derived, got %d; %s",
            limit,
            found,
        )

    def _play(
        self, policy: TensorDictModuleBase, scenario: str, seed: int, episodes: int
    ) -> Episodes:
        factory, env = self.scenarios[scenario], self._env(scenario, episodes)
        return run_episodes(env, policy, episodes, seed, factory.max_episode_steps, factory.metrics)

    def _env(self, scenario: str, episodes: int) -> EnvBase:
        """The scenario's environment, with as few slots as that number of batches needs.

        So fewer slots are played in vain than there are batches: 99 episodes take 2 x 50 slots.
        """
        factory, slots = self.scenarios[scenario], 1
        if factory.batching == "native":
            batches = -(-episodes // self.settings.slots)
            slots = -(-episodes // batches)
        if (scenario, slots) not in self._envs:
            with isolated_generators(0):  # whatever it draws to be built, training does not notice
                self._envs[scenario, slots] = factory.make(slots)
            self._envs[scenario, slots].listen_to(self._requests, repeats=False)
        return self._envs[scenario, slots]
