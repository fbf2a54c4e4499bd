"""Transitions from the training environment, collected in turn with the updates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.envs.utils import ExplorationType

from rrl.keys import ACTION
from rrl.slot_masks import resets_itself

from ..environment import EnvironmentFactory
from ..generators import seed_generators
from ..loggers import metrics
from ..requests import Request, Requests, stand_still, stop_of
from ..settings import TrainerSettings
from ..storage.replay_store import as_stored
from .collection_metrics import Authority, EpisodeReturns, collection_metrics
from .episode_state import EpisodeInProgress
from .interface import Annealing, Exploration, Interface, prepare
from .profiling import measured, watch_collection
from .torchrl_collector import Collector

Metrics = dict[str, float]


class Collection(ABC):
    """Where the trainer gets its transitions from, round by round.

    A round calls :meth:`collect`, and before its updates :meth:`before_updates`.
    """

    interface: Interface
    requests: Requests
    """What a person asks of the environments of this process."""
    is_ahead = False
    """Whether a round is being collected that :meth:`collect` has not returned."""

    def tell(self, request: Request) -> None:
        """Pass on what a person asks for."""
        self.requests.take(request)

    @abstractmethod
    def set_policy(self, policy: TensorDictModuleBase) -> None:
        """Act with ``policy`` from now on; called once."""

    @abstractmethod
    def collect(self, env_steps: int) -> tuple[TensorDictBase, Metrics]:
        """Return transitions ``[E, T]`` of the round that starts at ``env_steps``, and metrics."""

    def recover(self, env_steps: int) -> Metrics:
        """Return metrics of a round that was stored before the run died, as far as they are kept.

        Args:
            env_steps: Where the round starts.
        """
        return {}

    def release(self) -> None:
        """End a pause, because the run is to end: nothing waits any longer."""
        self.tell(Request.GO_ON)

    def before_updates(self, next_round: int | None, checkpoint_due: bool) -> None:  # noqa: B027
        """Prepare for the updates of this round, during which the next may be collected.

        Args:
            next_round: At which step the next round starts; None where none may begin yet.
            checkpoint_due: Whether :meth:`state_dict` is wanted after this round.
        """

    @property
    @abstractmethod
    def can_continue(self) -> bool:
        """Whether the environment can go on in the middle of an episode."""

    @property
    def recoverable(self) -> int | None:
        """Up to which step :meth:`recover` finds the run's rounds; None: it needs nothing."""
        return None

    @abstractmethod
    def start_episode(self, seed: int) -> None:
        """Begin the next episode; what is random about it comes from ``seed``."""

    def paused(self) -> AbstractContextManager[None]:
        """Leave the environment to somebody else while the body runs, such as an evaluation."""
        return nullcontext()

    def forget(self, first: int) -> None:  # noqa: B027
        """Remove what is on disk of steps before ``first`` beside the stored transitions."""

    def stop(self) -> None:  # noqa: B027
        """Have a robot stand still; what is collected next begins with an episode."""

    @contextmanager
    def attended(self) -> Iterator[None]:
        """Stop a robot if the body fails: nobody looks after it any more."""
        try:
            yield
        except BaseException:
            self.stop()
            raise

    def stop_at_once(self) -> None:  # noqa: B027
        """Have a robot stand still, or a process end that goes on alone; nothing is waited for."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """Return everything that a checkpoint after this round needs."""

    @abstractmethod
    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`."""

    @abstractmethod
    def close(self) -> None:
        """Close the environment."""


class Apart(Collection):
    """Collects in another process, while evaluations play in this one."""

    _evaluates = False

    def tell(self, request: Request) -> None:
        """Pass on what a person asks for; a judgement is for training, or for an evaluation."""
        judges = request in (Request.SUCCEEDED, Request.FAILED)
        if self._evaluates or not judges:
            self.requests.take(request)
        if not (self._evaluates and judges):
            self.pass_on(request)

    @abstractmethod
    def pass_on(self, request: Request) -> None:
        """Tell the other process."""

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Have judgements be for what is played here while the body runs."""
        self._evaluates = True
        try:
            yield
        finally:
            self._evaluates = False


class InTurn(Collection):
    """Collects in the calling process, with the policy as the last update left it.

    Args:
        settings: Of the run.
        environment: Builds the training environment.
        exploration: Makes the exploration module.
    """

    def __init__(
        self, settings: TrainerSettings, environment: EnvironmentFactory, exploration: Exploration
    ) -> None:
        self.settings = settings
        self.env, self.interface, self.exploration = prepare(settings, environment, exploration)
        self.requests = Requests()
        self.env.listen_to(self.requests)
        self._returns = EpisodeReturns(settings.num_envs)
        self._annealing = Annealing(self.exploration)
        self._stands = False  # a robot, since it was told to

    def set_policy(self, policy: TensorDictModuleBase) -> None:
        """Act with ``policy`` and exploration noise."""
        modules: dict[str, TensorDictModuleBase] = {"policy": TensorDictSequential(policy)}
        if self.exploration is not None:
            modules["exploration"] = self.exploration
        self.collector = Collector(
            self.env,
            TensorDictSequential(*modules.values()),
            frames_per_batch=self.settings.steps_per_round,
            device=self.env.device,  # known to be the policy's too, or every step is copied for it
            track_traj_ids=False,
            use_buffers=False,
            trust_policy=True,
            auto_register_policy_transforms=False,
            exploration_type=ExplorationType.RANDOM,
        )
        self.episode = EpisodeInProgress(self.env, self.collector)
        self.stopwatch = watch_collection(self.env, modules) if self.settings.profile else None

    def rollout(self, env_steps: int) -> TensorDictBase:
        """Return all that the environment wrote in a round, ``[E, T]``."""
        explores = env_steps >= (self.settings.controller_steps or 0)
        random, fixed = ExplorationType.RANDOM, ExplorationType.DETERMINISTIC
        self.collector.exploration_type = random if explores else fixed
        self._annealing.reach(env_steps)  # rounds that were taken from the log
        if self._stands:
            self.collector.reset()
            self._returns.reset()
            self._stands = False
        data = self.collector.rollout()
        self._annealing.reach(env_steps + self.settings.steps_per_round)
        # Exploration modules draw in the process's default type; networks are of float32.
        data.set(ACTION, data[ACTION].float())
        return data.reshape(self.settings.num_envs, -1)

    def collect(self, env_steps: int) -> tuple[TensorDictBase, Metrics]:
        """Collect now."""
        with torch.no_grad():
            data = self.rollout(env_steps)
            kept = self.interface.kept
            if resets_itself(self.env):
                hidden = [key for key in kept if key not in self.interface.costs]
                _fill_in_last_observations(data, hidden)
            values = collection_metrics(data, Authority.of(self.env)) | self._returns.metrics(data)
            stored = as_stored(data, kept)  # where an operator acted, the action is theirs now
        return stored, values | measured(self.stopwatch) | metrics.clock(self.env.lap())

    @property
    def can_continue(self) -> bool:
        """Whether the environment can go on in the middle of an episode."""
        return self.episode.can_continue

    def start_episode(self, seed: int) -> None:
        """Begin the next episode."""
        seed_generators(seed)  # or exploration would be that of the steps before
        self.episode.start_anew(seed)
        self._returns.reset()
        self._stands = False

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Leave a robot to somebody else while the body runs; it is one and the same."""
        self.stop()
        yield

    def stop(self) -> None:
        """Have a robot stand still; what is collected next begins with an episode."""
        self._stands = stop_of(self.env) is not None
        stand_still(self.env)

    stop_at_once = stop

    def state_dict(self) -> dict[str, Any]:
        """Return the state of episode, exploration and running returns."""
        exploration = {} if self.exploration is None else self.exploration.state_dict()
        return {
            "episode": self.episode.state_dict(),
            "exploration": dict(exploration),
            "annealed": self._annealing.env_steps,
            "returns": self._returns.running,
            "stands": self._stands,
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        self.episode.load_state_dict(state["episode"])
        if self.exploration is not None:
            self.exploration.load_state_dict(state["exploration"])
        self._annealing.env_steps = int(state["annealed"])
        self._returns.running = state["returns"]
        self._stands = state["stands"]

    def close(self) -> None:
        """Shut the collector down, and with it the environment."""
        if hasattr(self, "collector"):
            self.collector.shutdown()
        else:
            self.env.close()


def _fill_in_last_observations(data: TensorDictBase, inputs: Iterable[NestedKey]) -> None:
    """Let an episode's last observation but one stand for the last one.

    An environment that resets itself hides the last one; TorchRL marks it with numbers that are not
    finite. What follows a termination is not looked at.
    """
    following = data["next"]
    for key in inputs:
        value = following[key]
        over = following["done"].reshape(*data.shape, *[1] * (value.ndim - data.ndim))
        following[key] = torch.where(over, data[key], value)
