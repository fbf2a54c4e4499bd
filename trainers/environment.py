"""From a bare environment and a controller to what the policy sees: the chain of transforms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import torch
from tensordict import NestedKey
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv
from torchrl.envs.transforms import (
    CatTensors,
    Compose,
    ObservationNorm,
    Transform,
)

from rrl.keys import OBSERVATION
from rrl.transforms import ResidualAction

Batching = Literal["native", "serial"]


@dataclass(frozen=True)
class Input:
    """How one observation entry enters the networks: ``(value - loc) * scale``."""

    loc: float | Sequence[float] = 0.0
    scale: float | Sequence[float] = 1.0

    def column(self, name: str, value: float | Sequence[float], size: int) -> torch.Tensor:
        """``value`` as a vector of ``size`` numbers.

        Raises:
            ValueError: if a list does not have ``size`` numbers.

        """
        column = torch.as_tensor(value, dtype=torch.float32)
        if column.ndim and column.numel() != size:
            raise ValueError(
                f"observation entry {name!r} has {size} numbers, but its loc or scale has {column.numel()}"
            )
        return column.expand(size)


@dataclass(frozen=True)
class EnvironmentFactory:
    """Builds transformed environments: ``[disturbances, sensing, residual, normalisation, concatenation]``.

    The order is the method's: on the way to the policy, sensing faults come before the controller, which therefore
    sees what a real one would see; on the way back the superposition comes first, then the disturbance.

    Args:
        base: makes the bare environment; called as ``base(num_envs=..., seed=...)`` when ``batching`` is ``native``,
            else without arguments.
        controller: makes a controller.
        inputs: the observation entries that the policy reads, in this order, and how each is normalised.
        disturbances: make the transforms of the executed action (control noise).
        sensing: make the transforms of the observation entries (camera noise, latency).
        residual_scale: authority of the residual, in half ranges of the action, per dimension or for all.
        batching: ``native`` for an environment with a batch size of its own, ``serial`` to run copies in turn.
        max_episode_steps: bound on an episode's length, for evaluation.

    """

    base: Callable[..., EnvBase]
    controller: Callable[[], TensorDictModuleBase]
    inputs: Mapping[str, Input]
    disturbances: Sequence[Callable[[], Transform]] = ()
    sensing: Sequence[Callable[[], Transform]] = ()
    residual_scale: float | Sequence[float] = 1.0
    batching: Batching = "native"
    max_episode_steps: int = 1000

    def with_overrides(self, **overrides: Any) -> EnvironmentFactory:
        """The same chain on a base environment with other arguments (another scenario)."""
        return replace(self, base=partial(self.base, **overrides))

    def make(self, num_envs: int = 1) -> TransformedEnv:
        """Build the environment with ``num_envs`` slots.

        Raises:
            KeyError: if an input or the controller names an entry that the environment does not have.

        """
        env = TransformedEnv(self._make_base(num_envs), Compose())
        for make in (*self.disturbances, *self.sensing):
            env.append_transform(make())
        env.append_transform(ResidualAction(self.controller(), scale=self.residual_scale))
        self._append_inputs(env)
        return env

    def _make_base(self, num_envs: int) -> EnvBase:
        if self.batching == "native":
            return self.base(num_envs=num_envs)
        return self.base() if num_envs == 1 else SerialEnv(num_envs, self.base)

    def _append_inputs(self, env: TransformedEnv) -> None:
        spec = env.observation_spec
        available = sorted(map(str, spec.keys(True, True)))
        loc, scale = [], []
        for name, entry in self.inputs.items():
            if name not in spec.keys(True, True):
                raise KeyError(
                    f"environment.inputs names {name!r}, which the environment does not have; it has {available}"
                )
            size = spec[name].shape[-1]
            loc.append(entry.column(name, entry.loc, size))
            scale.append(entry.column(name, entry.scale, size))
        keys: list[NestedKey] = list(self.inputs)
        env.append_transform(CatTensors(in_keys=keys, out_key=OBSERVATION, del_keys=False, sort=False))
        scales = torch.cat(scale)
        env.append_transform(ObservationNorm(loc=-torch.cat(loc) * scales, scale=scales, in_keys=[OBSERVATION]))
