"""The environment's place in an exported chain: its specs, with a real robot behind them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.transforms import Transform

from rrl.keys import dotted
from rrl.transforms.base import RandomTransform

from ..environment import EnvironmentFactory
from ..resumable_env import ResumableEnv


class SpecsOnly(EnvBase):
    """The specs of an environment without what is behind them.

    It shows the entries that it is told to show, and keeps what it was commanded.

    Args:
        like: The bare environment whose specs these are.
        resets_itself: Whether it starts the next episode within the step that ends one.

    Attributes:
        shown: What the next reset or step gives.
        command: The action of the last step, ``[*batch, n_act]``.
    """

    shows_made_up_values = True  # a flag may be any number

    shown: TensorDictBase
    command: Tensor

    def __init__(self, like: EnvBase, resets_itself: bool = False) -> None:
        super().__init__(device="cpu", batch_size=like.batch_size)
        self.observation_spec = like.observation_spec.clone()
        self.full_action_spec = like.full_action_spec.clone()
        self.full_reward_spec = like.full_reward_spec.clone()
        self.full_done_spec = like.full_done_spec.clone()
        self.__dict__["_torchrl_native_autoreset"] = resets_itself

    def blank(self) -> TensorDictBase:
        """Return everything that a step gives, as zeros."""
        td = TensorDict({}, batch_size=self.batch_size)
        for spec in (self.observation_spec, self.full_reward_spec, self.full_done_spec):
            td.update(spec.zero())
        return td

    def entry_keys(self) -> dict[str, NestedKey]:
        """Return the observations' keys by name, the parts of a nested one joined by dots."""
        return {dotted(key): key for key in self.observation_spec.keys(True, True)}

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        return self.shown.select(*self.observation_spec.keys(True, True)).clone()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.command = tensordict[self.action_key].clone()
        return self.shown.clone()

    def _set_seed(self, seed: int | None) -> None:
        """Draw nothing."""


def chain_on(robot: SpecsOnly, environment: EnvironmentFactory, **changes: Any) -> ResumableEnv:
    """Build the factory's transforms on ``robot``, without what simulates a fault.

    Disturbances leave no more than the entries that they write. Of sensing, what draws no random
    numbers prepares entries and stays as it is.

    Args:
        robot: Takes the environment's place.
        environment: The factory.
        changes: Fields of the factory to replace.
    """
    recording = [m for m in environment.disturbances if isinstance(m(), RandomTransform)]
    return replace(
        environment,
        base=lambda num_envs: robot,
        batching="native",
        disturbances=[partial(_silent, make) for make in recording],
        sensing=[partial(_silent, make) for make in environment.sensing],
        **changes,
    ).make(1)


def _silent(make: Callable[[], Transform]) -> Transform:
    transform = make()
    if isinstance(transform, RandomTransform):
        transform.silence()
    return transform
