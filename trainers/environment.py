"""From a bare environment and a controller to what the policy sees: the chain of transforms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import torch
from pydantic import BaseModel, ConfigDict
from tensordict import NestedKey
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torchrl.data import Composite
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv, TransformedEnv
from torchrl.envs.transforms import (
    CatTensors,
    Compose,
    DoubleToFloat,
    DTypeCastTransform,
    FlattenObservation,
    ObservationNorm,
    Transform,
)

from rrl.keys import (
    ACTION,
    BASE_ACTION,
    DIVERGED,
    METRICS,
    OBSERVATION,
    PREVIOUS_ACTION,
    REWARD_TERMS,
    SAFETY,
    SUCCESS,
)
from rrl.symmetry import Symmetry, as_map
from rrl.transforms import ActionHistory, ResidualAction

Batching = Literal["native", "serial", "parallel"]
Reduction = Literal["max", "min", "mean", "sum", "last"]
_BATCHED = {"serial": SerialEnv, "parallel": ParallelEnv}


@dataclass(frozen=True)
class Input:
    """How one observation entry enters the networks: ``(value - loc) * scale``."""

    loc: float | Sequence[float] = 0.0
    scale: float | Sequence[float] = 1.0

    def __call__(self, value: torch.Tensor) -> torch.Tensor:
        """Normalise ``value`` [..., n]."""
        loc, scale = torch.as_tensor(self.loc), torch.as_tensor(self.scale)
        return value * scale - loc * scale

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


class Metric(BaseModel):
    """How a quantity that the environment writes under ``("metrics", NAME)`` is reported.

    Attributes:
        unit: The unit, for axes and tables.
        reduce: How the steps of an episode become its one value.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    unit: str = ""
    reduce: Reduction = "mean"


@dataclass(frozen=True)
class EnvironmentFactory:
    """Builds environments: ``[safety, disturbances, sensing, residual, memory, concatenation, normalisation]``.

    The order is the method's: on the way to the policy, sensing faults come before the controller, which therefore
    sees what a real one would see; on the way back the superposition comes first, then the disturbance, and safety
    limits have the last word. An environment in double precision is converted to float32 first.

    Args:
        base: makes the bare environment; called as ``base(num_envs=..., seed=...)`` when ``batching`` is ``native``,
            else without arguments.
        controller: makes a controller.
        inputs: the observation entries that the policy reads, in this order, and how each is normalised; a plain list
            of names leaves them as they are. Beside the environment's own there are ``base_action`` and
            ``previous_action``, what the policy said in the last ``action_history`` steps.
        disturbances: make the transforms of the executed action (control noise).
        sensing: make the transforms of the observation entries (camera noise, latency).
        safety: make the transforms that limit what reaches the environment.
        residual_scale: authority of the residual, in half ranges of the action, per dimension or for all.
        batching: ``native`` for an environment with a batch size of its own, ``serial`` to run copies in turn,
            ``parallel`` to run each copy in its own process.
        max_episode_steps: bound on an episode's length, for evaluation.
        action_history: how many actions ``previous_action`` holds, if the policy reads it.
        symmetries: mirrors of the task by name, each with a map (:class:`rrl.symmetry.Symmetry`) of ``action`` and of
            every input but ``base_action`` and ``previous_action``, which are actions. A mirror goes through the
            inputs' ``loc``.
        metrics: Unit and reduction of what the environment writes under ``("metrics", NAME)``, by
            name. Names that are not here are reported with their mean and without a unit.
    """

    base: Callable[..., EnvBase]
    controller: Callable[[], TensorDictModuleBase]
    inputs: Mapping[str, Input] | Sequence[str]
    disturbances: Sequence[Callable[[], Transform]] = ()
    sensing: Sequence[Callable[[], Transform]] = ()
    safety: Sequence[Callable[[], Transform]] = ()
    residual_scale: float | Sequence[float] = 1.0
    batching: Batching = "native"
    max_episode_steps: int = 1000
    action_history: int = 1
    symmetries: Mapping[str, Mapping[str, Sequence[int]]] = field(default_factory=dict)
    metrics: Mapping[str, Metric] = field(default_factory=dict)

    def with_overrides(self, **overrides: Any) -> EnvironmentFactory:
        """The same chain on a base environment with other arguments (another scenario)."""
        return replace(self, base=partial(self.base, **overrides))

    def make(self, num_envs: int = 1) -> TransformedEnv:
        """Build the environment with ``num_envs`` slots.

        Raises:
            KeyError: if an input or the controller names an entry that the environment does not have.
            ValueError: If an entry that is reported is not one number a slot, or ``metrics`` names
                one that the environment does not write.
        """
        env = TransformedEnv(self._make_base(num_envs), Compose())
        _check_reported(env.observation_spec, env.ndim, self.metrics)
        if any(spec.dtype == torch.float64 for spec in env.specs.values(True, True)):
            env.append_transform(DoubleToFloat())
        for key in (SUCCESS, DIVERGED):  # some environments write 0.0 and 1.0
            if (dtype := _dtype(env.observation_spec, key)) not in (None, torch.bool):
                env.append_transform(DTypeCastTransform(dtype, torch.bool, in_keys=[key]))
        for make in (*self.safety, *self.disturbances, *self.sensing):
            env.append_transform(make())
        env.append_transform(ResidualAction(self.controller(), scale=self.residual_scale))
        if PREVIOUS_ACTION in self.inputs:
            env.append_transform(ActionHistory(self.action_history))
        self._append_inputs(env)
        return env

    def reader(self) -> TensorDictModule:
        """The module from the input entries to ``observation``, as the policy sees it.

        In front of a policy that was trained here it makes one that reads what the bare environment writes, for
        instance to be the controller under a further residual.
        """
        entries = self._inputs()

        def concatenate(*values: torch.Tensor) -> torch.Tensor:
            return torch.cat(
                [entry(value) for entry, value in zip(entries.values(), values, strict=True)], -1
            )

        return TensorDictModule(concatenate, in_keys=list(entries), out_keys=[OBSERVATION])

    def symmetry(self) -> Symmetry | None:
        """The symmetry of what the policy reads and says; None if there are no mirrors.

        Raises:
            ValueError: if a mirror lacks an input's map, or has one that is no map or does not fit ``scale``.

        """
        if not self.symmetries:
            return None
        mirrors = []
        for name, given in self.symmetries.items():
            try:
                maps = {key: as_map(key, numbers) for key, numbers in given.items()}
                parts = [self._map(key, entry, maps) for key, entry in self._inputs().items()]
                mirrors.append((_joined(parts), maps[ACTION]))
            except KeyError as missing:
                raise ValueError(
                    f"symmetries.{name}: expected a map of {missing}, got {sorted(given)}"
                ) from None
            except ValueError as error:
                raise ValueError(f"symmetries.{name}.{error}") from None
        return Symmetry(mirrors)

    def _map(self, key: str, entry: Input, maps: Mapping[str, Sequence[int]]) -> Sequence[int]:
        if key in (BASE_ACTION, PREVIOUS_ACTION):
            return _joined([maps[ACTION]] * (self.action_history if key == PREVIOUS_ACTION else 1))
        scale = entry.column(key, entry.scale, len(maps[key]))
        if any(scale[abs(i) - 1] != scale[n] for n, i in enumerate(maps[key])):
            raise ValueError(
                f"{key}: expected equal scales of numbers that the mirror exchanges, got {entry.scale}"
            )
        return maps[key]

    def _inputs(self) -> dict[str, Input]:
        if isinstance(self.inputs, Mapping):
            return dict(self.inputs)
        return {name: Input() for name in self.inputs}

    def _make_base(self, num_envs: int) -> EnvBase:
        if self.batching == "native":
            return self.base(num_envs=num_envs)
        return self.base() if num_envs == 1 else _BATCHED[self.batching](num_envs, self.base)

    def _append_inputs(self, env: TransformedEnv) -> None:
        spec = env.observation_spec
        available = sorted(map(str, spec.keys(True, True)))
        loc, scale = [], []
        inputs = self._inputs()
        for name, entry in inputs.items():
            if name not in spec.keys(True, True):
                raise KeyError(
                    f"environment.inputs names {name!r}, which the environment does not have; it has {available}"
                )
            extra = (
                spec[name].ndim - env.ndim - 1
            )  # an image or a list of frames enters as one vector
            if extra > 0:
                env.append_transform(FlattenObservation(-1 - extra, -1, in_keys=[name]))
            size = spec[name].shape[env.ndim :].numel()
            loc.append(entry.column(name, entry.loc, size))
            scale.append(entry.column(name, entry.scale, size))
        keys: list[NestedKey] = list(inputs)
        env.append_transform(
            CatTensors(in_keys=keys, out_key=OBSERVATION, del_keys=False, sort=False)
        )
        scales = torch.cat(scale)
        env.append_transform(
            ObservationNorm(loc=-torch.cat(loc) * scales, scale=scales, in_keys=[OBSERVATION])
        )


def _dtype(spec: Composite, key: str) -> torch.dtype | None:
    return spec[key].dtype if key in spec.keys() else None  # noqa: SIM118 - a spec is no dict


def _check_reported(spec: Composite, batch_dims: int, declared: Mapping[str, Metric]) -> None:
    """Refuse reserved entries that cannot be reported: each must be one number a slot."""
    leaves = {key: spec[key] for key in (SUCCESS, DIVERGED) if _dtype(spec, key)}
    for group in (METRICS, SAFETY, REWARD_TERMS):
        entries = spec[group] if group in spec.keys() else Composite()  # noqa: SIM118
        if not isinstance(entries, Composite):
            shape = list(entries.shape[batch_dims:])
            raise ValueError(
                f"environment: {group}: expected named entries ({group!r}, NAME) of one number "
                f"each, got a tensor {shape}"
            )
        leaves |= {f"{group}/{name}": leaf for name, leaf in entries.items()}
    for name, leaf in leaves.items():
        shape = list(leaf.shape[batch_dims:])
        if isinstance(leaf, Composite) or leaf.shape[batch_dims:].numel() != 1:
            got = "a nested entry" if isinstance(leaf, Composite) else f"a tensor {shape}"
            raise ValueError(
                f"environment: {name}: expected one number a slot [*batch, 1], got {got}: write "
                "each component under its own name, or a norm"
            )
    written = [name.partition("/")[2] for name in leaves if name.startswith(f"{METRICS}/")]
    if missing := sorted(set(declared) - set(written)):
        raise ValueError(
            f"environment: metrics: expected names that the environment writes {written}, "
            f"got {missing}"
        )


def _joined(maps: Sequence[Sequence[int]]) -> list[int]:
    """One map of vectors that stand one after the other."""
    joined: list[int] = []
    for numbers in maps:
        offset = len(joined)
        joined += [i + offset if i > 0 else i - offset for i in numbers]
    return joined
