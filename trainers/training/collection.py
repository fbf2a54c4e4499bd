"""Experience from the training environment: in turn with the updates, or while they run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.collectors import Collector
from torchrl.envs.transforms import InitTracker
from torchrl.envs.utils import ExplorationType

from rrl.exploration import Ramp
from rrl.keys import ACTION, OBSERVATION
from rrl.slot_random import seed_env

from ..environment import EnvironmentFactory
from ..settings import TrainerSettings
from ..storage.replay_store import STORED
from .collection_metrics import experience_metrics
from .episode_state import EpisodeInProgress
from .profiling import measured, watch_collection

Metrics = dict[str, list[float]]


@dataclass(frozen=True)
class Sizes:
    """What a learner must know of the environment."""

    inputs: dict[str, int]
    action: int


class Experience(ABC):
    """Where the trainer gets its transitions from, round by round.

    A round calls :meth:`collect`, and before its updates :meth:`begin`.
    """

    sizes: Sizes

    @abstractmethod
    def follow(self, policy: TensorDictModuleBase) -> None:
        """Act with ``policy`` from now on; called once."""

    @abstractmethod
    def collect(self, env_steps: int) -> tuple[TensorDictBase, Metrics]:
        """The transitions ``[S * E, T]`` of the round that starts at ``env_steps``, and what they say."""

    @abstractmethod
    def begin(self, env_steps: int | None, checkpoint: bool) -> None:
        """The updates of this round begin.

        Args:
            env_steps: at which the next round starts; None where nothing may be under way after this round, because no
                other follows or it does not collect.
            checkpoint: whether :meth:`state_dict` is wanted after this round.

        """

    @property
    @abstractmethod
    def under_way(self) -> bool:
        """Whether a collection was begun that :meth:`collect` has not returned."""

    @property
    @abstractmethod
    def continues(self) -> bool:
        """Whether the environment can go on in the middle of an episode; see :class:`EpisodeInProgress`."""

    @abstractmethod
    def start_anew(self, seed: int) -> None:
        """Begin the next episode; what is random about it comes from ``seed``."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """Everything that a checkpoint after this round needs."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`."""

    @abstractmethod
    def close(self) -> None:
        """Close the environment."""


class InTurn(Experience):
    """Collects in the calling process, with the policy as the last update left it.

    Args:
        settings: of the run.
        environment: builds the training environment.
        exploration: makes the exploration module; called with ``spec``, ``num_slots`` and ``seed``.

    """

    def __init__(
        self,
        settings: TrainerSettings,
        environment: EnvironmentFactory,
        exploration: Callable[..., TensorDictModuleBase],
    ) -> None:
        self.settings = settings
        self.num_envs = settings.num_seeds * settings.envs_per_seed
        first_seed = settings.seed * settings.envs_per_seed
        self.env = environment.make(self.num_envs)
        seed_env(self.env, first_seed)
        spec = self.env.full_action_spec[ACTION]
        self.sizes = Sizes(
            {OBSERVATION: self.env.observation_spec[OBSERVATION].shape[-1]}, spec.shape[-1]
        )
        self.exploration = exploration(spec=spec, num_slots=self.num_envs, seed=first_seed)
        if "is_init" in self.exploration.in_keys:
            self.env.append_transform(InitTracker())
        self.ramp = Ramp()
        self._decayed = 0  # environment steps that the exploration module knows of

    def follow(self, policy: TensorDictModuleBase) -> None:
        """Act with ``policy``, exploration noise and the residual's share."""
        self.policy = policy
        self.collector = Collector(
            self.env,
            TensorDictSequential(policy, self.exploration, self.ramp),
            frames_per_batch=self.num_envs * self.settings.steps_per_collection,
            device=self.env.device,  # known to be the policy's too, or every step is copied for it
            track_traj_ids=False,
            use_buffers=False,
            trust_policy=True,
            auto_register_policy_transforms=False,
            exploration_type=ExplorationType.RANDOM,
        )
        self.episode = EpisodeInProgress(self.env, self.collector)
        modules = {"policy": policy, "exploration": self.exploration}
        self.stopwatch = watch_collection(self.env, modules) if self.settings.profile else None

    def rollout(self, env_steps: int) -> TensorDictBase:
        """Everything that the environment wrote in the round that starts at ``env_steps``, ``[S * E, T]``."""
        explores = self.settings.warmup_exploration or env_steps >= self.settings.warmup_steps
        self.collector.exploration_type = (
            ExplorationType.RANDOM if explores else ExplorationType.DETERMINISTIC
        )
        self.ramp.share = self.settings.residual_share(env_steps)
        self._decay(env_steps)  # rounds that were taken from the log
        data = self.collector.rollout()
        self._decay(env_steps + self.settings.steps_per_round)
        return data

    def _decay(self, env_steps: int) -> None:
        if hasattr(
            self.exploration, "step"
        ):  # TorchRL's name for the decay of an exploration module
            self.exploration.step(env_steps - self._decayed)
        self._decayed = env_steps

    def collect(self, env_steps: int) -> tuple[TensorDictBase, Metrics]:
        """Collect now."""
        data, seeds = self.rollout(env_steps), self.settings.num_seeds
        return data.select(*STORED), experience_metrics(data, seeds, self.env) | measured(
            self.stopwatch, seeds
        )

    def begin(self, env_steps: int | None, checkpoint: bool) -> None:
        """Nothing to do ahead."""

    @property
    def under_way(self) -> bool:
        """Never."""
        return False

    @property
    def continues(self) -> bool:
        """Whether the bare environment has a state to save."""
        return self.episode.continues

    def start_anew(self, seed: int) -> None:
        """Begin the next episode."""
        self.episode.start_anew(seed)

    def state_dict(self) -> dict[str, Any]:
        """The episode in progress and the exploration's state."""
        return {
            "episode": self.episode.state_dict(),
            "exploration": self.exploration.state_dict(),
            "decayed": self._decayed,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore both."""
        self.episode.load_state_dict(state["episode"])
        self.exploration.load_state_dict(state["exploration"])
        self._decayed = int(state["decayed"])

    def close(self) -> None:
        """Shut the collector down, and with it the environment."""
        if hasattr(self, "collector"):
            self.collector.shutdown()
        else:
            self.env.close()
