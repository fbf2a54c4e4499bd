"""What a run must know of its environment, and the environment made ready for collecting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.transforms import InitTracker

from rrl.inputs import Input, channels_of
from rrl.keys import ACTION, BASE_ACTION, METRICS, SO_FAR
from rrl.slot_random import seed_env
from rrl.transforms import EpisodeValue, FiniteObservation

from ..environment import EnvironmentFactory
from ..resumable_env import ResumableEnv
from ..seeds import Stream, first_seed
from ..settings import TrainerSettings
from ..storage.replay_store import as_stored
from .constraints import budgets

Exploration = Callable[..., TensorDictModuleBase | None]
"""Makes TorchRL's exploration module, or None where the policy explores by itself; called with
``spec``."""


class Annealing:
    """Tells an exploration module, where it anneals, how many environment steps there were.

    Args:
        exploration: The module; None: there is none.

    Attributes:
        env_steps: What it was told last.
    """

    def __init__(self, exploration: TensorDictModuleBase | None) -> None:
        self._anneal = getattr(exploration, "step", None)
        self.env_steps = 0

    def reach(self, env_steps: int) -> None:
        """Say that there were so many."""
        if self._anneal is not None:
            self._anneal(env_steps - self.env_steps)
        self.env_steps = env_steps


@dataclass(frozen=True)
class Interface:
    """What a run must know of the environment.

    Attributes:
        inputs: Of the policy.
        action_size: Numbers of an action.
        critic_inputs: Of the critics; None: the same.
        costs: Entries that constraints are about.
        room: Bytes of a transition in memory, and on disk with the acting process's record of it.
    """

    inputs: dict[str, Input]
    action_size: int
    critic_inputs: dict[str, Input] | None = None
    costs: tuple[NestedKey, ...] = ()
    room: tuple[int, int] = (0, 0)

    @property
    def kept(self) -> list[NestedKey]:
        """What is stored of a state: all that actor, critics and constraints read."""
        return [*(self.inputs | (self.critic_inputs or {})), *self.costs]

    def arguments(self) -> dict[str, Any]:
        """Return the arguments that a learner is made with."""
        arguments = {"inputs": self.inputs, "action_size": self.action_size}
        if self.critic_inputs is not None:
            arguments["critic_inputs"] = self.critic_inputs
        return arguments

    def described(self) -> dict[str, Any]:
        """Return what a resumed run must find as it was, in the order in which it is read."""
        groups = {"inputs": self.inputs, "critic_inputs": self.critic_inputs or {}}
        named = {
            group: [f"{name} {list(entry.shape)}" for name, entry in entries.items()]
            for group, entries in groups.items()
        }
        return {"action_size": self.action_size, **named}


def interface_of(environment: EnvironmentFactory, env: EnvBase) -> Interface:
    """Return what a learner must know of an environment that the factory has made."""
    size = env.full_action_spec[ACTION].shape[-1]
    return Interface(environment.read_inputs(env), size, environment.read_critic_inputs(env))


def prepare(
    settings: TrainerSettings, environment: EnvironmentFactory, exploration: Exploration
) -> tuple[ResumableEnv, Interface, TensorDictModuleBase | None]:
    """Build the training environment, seeded, and the exploration module for it."""
    env = environment.make(settings.num_envs, operated=True)
    seed_env(env, first_seed(Stream.TRAINING, settings.seed))
    explore = exploration(spec=env.full_action_spec[ACTION])
    if hasattr(explore, "is_init_key"):  # a process that starts anew with an episode
        env.append_transform(InitTracker())
    constrained = budgets(environment.metrics, settings.constraints)
    if constrained:
        reductions = {(METRICS, n): environment.metrics[n].reduce for n in constrained}
        env.append_transform(EpisodeValue(reductions))
    costs = tuple((SO_FAR, name) for name in constrained)
    interface = replace(interface_of(environment, env), costs=costs)
    env.append_transform(FiniteObservation(list(dict.fromkeys([*interface.kept, BASE_ACTION]))))
    size = _transition_bytes(env, interface) // settings.num_envs
    return env, replace(interface, room=(size, size)), explore


def _transition_bytes(env: EnvBase, interface: Interface) -> int:
    """Return what a transition of all slots takes; an image is not stored with what follows too."""
    example = as_stored(env.fake_tensordict(), interface.kept)
    return sum(
        value.numel() * value.element_size()
        for key, value in example.items(True, True)
        if key[0] != "next" or channels_of(value.shape[env.ndim :], value.dtype) == "none"
    )
