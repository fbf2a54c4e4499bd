"""Exploration noise that belongs to one environment slot (the paper's random process N, algorithm 1)."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.data import TensorSpec
from torchrl.envs.utils import ExplorationType, exploration_type
from torchrl.modules import AdditiveGaussianModule

from rrl.keys import ACTION
from rrl.random import SlotGenerators


class GaussianExploration(AdditiveGaussianModule):
    """Add ``N(0, sigma^2)`` to the policy's action and project the sum on the action bounds.

    TorchRL's module with one random stream per environment slot in place of the global generator, so that a slot
    explores alike in whatever batch it is. ``step()`` anneals ``sigma`` to ``sigma_end``.

    Args:
        spec: the action's spec, batch size included.
        sigma: standard deviation in normalised action units.
        sigma_end: its value after ``annealing_steps`` calls of ``step``; ``sigma`` when left out.
        annealing_steps: number of calls over which ``sigma`` falls.
        num_slots: environments in the batch.
        seed: slot ``i`` draws what ``seed + i`` alone would draw.
    """

    def __init__(
        self,
        spec: TensorSpec,
        *,
        sigma: float,
        sigma_end: float | None = None,
        annealing_steps: int = 1,
        num_slots: int = 1,
        seed: int = 0,
    ) -> None:
        if sigma < 0:
            raise ValueError(f"sigma: expected a standard deviation of 0 or more, got {sigma}")
        super().__init__(
            spec,
            sigma_init=float(sigma),
            sigma_end=float(sigma if sigma_end is None else sigma_end),
            annealing_num_steps=annealing_steps,
            action_key=ACTION,
        )
        self.generators = SlotGenerators(seed, num_slots, stream="exploration")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Perturb ``action`` in place, if the exploration type is random."""
        if exploration_type() in (ExplorationType.RANDOM, None):
            action = tensordict.get(ACTION)
            noise = self.generators.normal(action.shape[-1:]).view(action.shape)
            tensordict.set(ACTION, self._spec[ACTION].project(action + self.sigma * noise))
        return tensordict

    def get_extra_state(self) -> dict[str, Any]:
        """The generators' state."""
        return self.generators.state_dict()

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the generators' state."""
        self.generators.load_state_dict(state)


class OrnsteinUhlenbeckExploration(TensorDictModuleBase):
    """Add a temporally correlated process to the policy's action, started anew with every episode.

    The discretised process ``n <- n - theta n dt + sigma sqrt(dt) N(0, 1)`` with one random stream per environment
    slot. TorchRL's own module draws from the global generator and keeps the process in the TensorDict; here it is a
    buffer, so that a checkpoint holds it. Reads ``action`` and ``is_init``
    (:class:`torchrl.envs.transforms.InitTracker`, which the trainer adds), writes ``action``.

    Args:
        spec: the action's spec, batch size included.
        sigma: scale of the increments, in normalised action units.
        theta: rate of the pull towards zero.
        dt: time step of the discretisation.
        num_slots: environments in the batch.
        seed: slot ``i`` draws what ``seed + i`` alone would draw.
    """

    in_keys = (ACTION, "is_init")
    out_keys = (ACTION,)

    def __init__(
        self,
        spec: TensorSpec,
        *,
        sigma: float,
        theta: float = 0.15,
        dt: float = 1.0,
        num_slots: int = 1,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if sigma < 0:
            raise ValueError(f"sigma: expected a scale of 0 or more, got {sigma}")
        self.spec = spec
        self.sigma, self.theta, self.dt = sigma, theta, dt
        self.generators = SlotGenerators(seed, num_slots, stream="exploration")
        self.noise: torch.Tensor
        self.register_buffer("noise", torch.zeros(spec.shape))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Perturb ``action`` in place, if the exploration type is random."""
        if exploration_type() in (ExplorationType.RANDOM, None):
            action = tensordict.get(ACTION)
            increment = self.generators.normal(action.shape[-1:]).view(action.shape)
            noise = self.noise * ~tensordict.get("is_init")
            self.noise = noise * (1 - self.theta * self.dt) + self.sigma * self.dt**0.5 * increment
            tensordict.set(ACTION, self.spec.project(action + self.noise))
        return tensordict

    def get_extra_state(self) -> dict[str, Any]:
        """The generators' state."""
        return self.generators.state_dict()

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the generators' state."""
        self.generators.load_state_dict(state)


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
