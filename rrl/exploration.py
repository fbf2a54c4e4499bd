"""Exploration noise that belongs to one environment slot (the paper's random process N, algorithm 1)."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Bounded, TensorSpec
from torchrl.envs.utils import ExplorationType, exploration_type

from rrl.keys import ACTION
from rrl.slot_random import SlotGenerators

__all__ = [
    "ExplorationNoise",
    "GaussianExploration",
    "NoExploration",
    "OrnsteinUhlenbeckExploration",
    "Ramp",
]


class ExplorationNoise(TensorDictModuleBase):
    """Add noise to the policy's action and project the sum on the action bounds; a subclass says which noise.

    TorchRL's modules draw from the global generator. Here every environment slot has a random stream of its own, so
    that it explores alike in whatever batch it is.

    Args:
        spec: the action's spec, batch size included.
        sigma: scale of the noise, in normalised action units.
        sigma_end: its value after ``decay_steps``; None: ``sigma`` stays.
        decay_steps: steps (of :meth:`step`) over which ``sigma`` falls, or rises, in a straight line.
        num_slots: environments in the batch.
        seed: slot ``i`` draws what ``seed + i`` alone would draw.

    Raises:
        ValueError: if a scale is negative or there is not at least one step to decay over.

    """

    in_keys: tuple[str, ...] = (ACTION,)
    out_keys = (ACTION,)

    def __init__(
        self,
        spec: TensorSpec,
        *,
        sigma: float,
        sigma_end: float | None = None,
        decay_steps: int = 10_000,
        num_slots: int = 1,
        seed: int = 0,
    ) -> None:
        super().__init__()
        for name, value in (
            ("sigma", sigma),
            ("sigma_end", sigma if sigma_end is None else sigma_end),
        ):
            if value < 0:
                raise ValueError(f"{name}: expected a scale of 0 or more, got {value}")
        if decay_steps < 1:
            raise ValueError(f"decay_steps: expected at least 1 step, got {decay_steps}")
        self.spec = spec
        # the spec's own projection costs several times as much, and its space moves the bounds whenever asked
        self._bounds = (spec.space.low, spec.space.high) if isinstance(spec, Bounded) else None
        self.sigma_init, self.sigma_end = sigma, sigma if sigma_end is None else sigma_end
        self.decay_steps, self.steps = decay_steps, 0
        self.generators = SlotGenerators(seed, num_slots, stream="exploration")

    @property
    def sigma(self) -> float:
        """Scale of the noise by now."""
        passed = min(1.0, self.steps / self.decay_steps)
        return self.sigma_init + (self.sigma_end - self.sigma_init) * passed

    def step(self, frames: int = 1) -> None:
        """Let ``frames`` steps of the decay pass; the trainer counts the environment steps of one seed."""
        self.steps += frames

    @abstractmethod
    def noise(self, normal: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Return what is added to the action, made of standard normal numbers of the same shape."""

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Perturb ``action`` in place, if the exploration type is random."""
        if exploration_type() in (ExplorationType.RANDOM, None):
            action = tensordict.get(ACTION)
            normal = self.generators.normal(action.shape[-1:]).view(action.shape)
            tensordict.set(ACTION, self._project(action + self.noise(normal, tensordict)))
        return tensordict

    def _project(self, action: Tensor) -> Tensor:
        return (
            self.spec.project(action)
            if self._bounds is None
            else torch.clamp(action, *self._bounds)
        )

    def get_extra_state(self) -> dict[str, Any]:
        """How far the decay is, and the generators' state."""
        return {"steps": self.steps, "generators": self.generators.state_dict()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`."""
        self.steps = state["steps"]
        self.generators.load_state_dict(state["generators"])


class GaussianExploration(ExplorationNoise):
    """Add ``N(0, sigma^2)``; see :class:`ExplorationNoise` for the arguments."""

    def noise(self, normal: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Return ``sigma * normal``."""
        return self.sigma * normal


class OrnsteinUhlenbeckExploration(ExplorationNoise):
    """Add a temporally correlated process, started anew with every episode.

    Steps of the same sign in a row drag and push where white noise trembles. The process is
    ``n <- (1 - theta) n + sigma sqrt(1 - (1 - theta)^2) N(0, 1)`` from ``n = 0``, whose standard deviation tends to
    ``sigma``; with ``theta = 1`` it is white. It is a buffer, so that a checkpoint holds it. Reads ``is_init`` too
    (:class:`torchrl.envs.transforms.InitTracker`, which the trainer adds).

    Args:
        theta: share of the process that is forgotten in a step, in (0, 1].
        spec, sigma, sigma_end, decay_steps, num_slots, seed: see :class:`ExplorationNoise`.

    Raises:
        ValueError: if ``theta`` is no such share.

    """

    in_keys = (ACTION, "is_init")

    def __init__(
        self,
        spec: TensorSpec,
        *,
        sigma: float,
        sigma_end: float | None = None,
        decay_steps: int = 10_000,
        theta: float = 0.15,
        num_slots: int = 1,
        seed: int = 0,
    ) -> None:
        super().__init__(
            spec,
            sigma=sigma,
            sigma_end=sigma_end,
            decay_steps=decay_steps,
            num_slots=num_slots,
            seed=seed,
        )
        if not 0 < theta <= 1:
            raise ValueError(f"theta: expected a share in (0, 1], got {theta}")
        self.kept = 1 - theta
        self.process: Tensor
        self.register_buffer("process", torch.zeros(spec.shape))

    def noise(self, normal: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Let the process make a step."""
        process = self.process * ~tensordict.get("is_init")
        self.process = self.kept * process + self.sigma * (1 - self.kept**2) ** 0.5 * normal
        return self.process


class NoExploration(TensorDictModuleBase):
    """Leave the action as it is: for policies that are stochastic themselves, such as SAC's.

    Args:
        spec, num_slots, seed: not used; what the trainer tells every exploration module.
    """

    in_keys = (ACTION,)
    out_keys = (ACTION,)

    def __init__(self, spec: TensorSpec, *, num_slots: int = 1, seed: int = 0) -> None:
        super().__init__()

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Return ``tensordict`` unchanged."""
        return tensordict


class Ramp(TensorDictModuleBase):
    """Multiply the exploring policy's action by ``share``: the schedule of a residual's authority.

    It stands after the exploration noise, so that the action that is stored is the one that acted. The transitions of
    every share therefore belong to one and the same environment, and critics can learn from all of them; changing the
    scale inside the environment would give one stored action different effects. Evaluation runs the policy itself.

    Attributes:
        share: from 0, the controller alone, to 1, the whole action; set by the trainer.
    """

    in_keys = (ACTION,)
    out_keys = (ACTION,)

    def __init__(self) -> None:
        super().__init__()
        self.share = 1.0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Scale ``action`` in place, if the exploration type is random."""
        if self.share != 1.0 and exploration_type() in (ExplorationType.RANDOM, None):
            tensordict.set(ACTION, tensordict.get(ACTION) * self.share)
        return tensordict
