"""Whether a graph does what the trainer's own chain does, on made-up entries."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.nn.functional import one_hot
from torchrl.data import MultiOneHot, OneHot, TensorSpec
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from rrl.deploy.contract import COMMAND
from rrl.deploy.policy import Graph
from rrl.keys import ACTION, BASE_ACTION
from rrl.transforms.base.action_bounds import limits_of

from ..environment import EnvironmentFactory
from .specs_only import SpecsOnly, chain_on
from .traced import Traced

EPISODES, STEPS = 3, 12
SIZES = (0.1, 1.0, 3.0)
"""How far from their centers entries lie, in their scales."""
PLACES = 16
"""How many numbers of an entry are made NaN in turn, at most."""

Played = tuple[TensorDictBase, TensorDictBase, Tensor]
"""One step: what was shown, what the policy made of it, what was commanded."""


class Rehearsal:
    """Plays episodes of made-up entries with the trainer's chain, and the same with a graph.

    Args:
        like: The bare environment, for its specs.
        environment: Makes the trainer's chain.
        policy: From the inputs to the residual ``action``.
        traced: The graph's entries and state.
    """

    steps = EPISODES * STEPS

    def __init__(
        self,
        like: EnvBase,
        environment: EnvironmentFactory,
        policy: TensorDictModuleBase,
        traced: Traced,
    ) -> None:
        self._robot = SpecsOnly(like)
        self._env, self._policy, self._traced = chain_on(self._robot, environment), policy, traced
        self._keys, self._inputs = self._robot.entry_keys(), environment.read_inputs(self._env)
        self._generator = torch.Generator().manual_seed(0)
        half_range = limits_of(like.full_action_spec[ACTION]).half_range.flatten().numpy()
        self._half_range = np.where(half_range == 0, 1.0, half_range)

    def difference(self, graph: Graph) -> float:
        """Return the largest difference of two commands, in half ranges of the action."""
        return max(self._difference(episode, graph) for episode in self._episodes)

    def deals_with_nan(self, name: str, graph: Graph, tolerance: float) -> bool:
        """Return whether NaN and infinity in an entry come to the same with graph and chain."""
        if name not in self._keys or not self._traced.entries[name].is_floating_point():
            return False
        broken = (list(self._play(script)) for script in self._broken(self._keys[name]))
        return all(self._difference(episode, graph) <= tolerance for episode in broken)

    @cached_property
    def _episodes(self) -> list[list[Played]]:
        scripts = [
            [self._entries(SIZES[step % len(SIZES)]) for step in range(STEPS)]
            for _ in range(EPISODES)
        ]
        return [list(self._play(script)) for script in scripts]

    def _difference(self, episode: Sequence[Played], graph: Graph) -> float:
        """Play an episode again; return the largest difference, infinite if one is NaN."""
        state = {f"state/{name}": value.numpy() for name, value in self._traced.state.items()}
        worst = 0.0
        for shown, acted, command in episode:
            entries = {
                f"entry/{name}": (acted if name == BASE_ACTION else shown)
                .get(self._keys.get(name, BASE_ACTION))
                .reshape(example.shape)
                .numpy()
                for name, example in self._traced.entries.items()
            }
            told = graph({**entries, **state})
            state = {f"state/{name}": told[f"next/{name}"] for name in self._traced.state}
            worst = max(worst, self._distance(command.flatten().numpy(), told[COMMAND]))
        return worst

    def _play(self, script: Sequence[TensorDictBase]) -> Iterator[Played]:
        """Play an episode with the trainer's chain."""
        self._robot.shown = script[0]
        td = self._env.reset()
        for shown, following in pairwise([*script, script[-1]]):
            self._robot.shown = following
            with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
                acted = self._policy(td)
                td = step_mdp(self._env.step(acted.clone()))
            yield shown, acted, self._robot.command

    def _distance(self, one: NDArray[Any], other: NDArray[Any]) -> float:
        same = (one == other) | (np.isnan(one) & np.isnan(other))
        distance = np.where(same, 0.0, np.abs(one - other.reshape(-1)) / self._half_range)
        return float(np.nan_to_num(distance, nan=np.inf).max())

    def _entries(self, size: float) -> TensorDictBase:
        """Make up what a robot shows, around what the policy expects."""
        td = self._robot.blank()
        for key in self._keys.values():
            spec = self._robot.observation_spec[key]
            if not spec.dtype.is_floating_point:
                td.set(key, self._whole(spec))
                continue
            center, scale = torch.zeros(()), torch.ones(())
            if key in self._inputs:
                center, scale = (self._inputs[key].column(c) for c in ("loc", "scale"))
            drawn = torch.randn(td.get(key).numel(), generator=self._generator) * size
            value = center + drawn / torch.where(scale == 0, 1.0, scale)
            td.set(key, spec.project(value.reshape(spec.shape).to(spec.dtype)))
        return td

    def _whole(self, spec: TensorSpec) -> Tensor:
        """Make up flags, bytes of a picture, one of several choices, or numbers around zero."""
        if isinstance(spec, (OneHot, MultiOneHot)):
            choices = spec.nvec if isinstance(spec, MultiOneHot) else [spec.shape[-1]]
            parts = [one_hot(self._random(0, n, spec.shape[:-1]), n) for n in choices]
            return torch.cat(parts, -1).to(spec.dtype)
        low, high = {torch.bool: (0, 2), torch.uint8: (0, 256)}.get(spec.dtype, (-9, 10))
        return spec.project(self._random(low, high, spec.shape).to(spec.dtype))

    def _random(self, low: int, high: int, shape: torch.Size) -> Tensor:
        return torch.randint(low, high, shape, generator=self._generator)

    def _broken(self, key: NestedKey) -> Iterator[list[TensorDictBase]]:
        """Yield episodes of two steps, with a number in the second that is not finite."""
        places = range(min(self._robot.blank().get(key).numel(), PLACES))
        cases = [(place, math.nan) for place in places] + [(0, math.inf), (0, -math.inf)]
        for place, value in cases:
            script = [self._entries(1.0) for _ in range(2)]
            script[1].get(key).view(-1)[place] = value
            yield script
