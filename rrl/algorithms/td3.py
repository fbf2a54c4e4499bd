"""TD3, from TorchRL's loss."""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar

from pydantic import Field, model_validator
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.objectives import TD3Loss

from rrl.algorithms.base import Agent
from rrl.algorithms.ensemble import EnsembleTD3Loss
from rrl.algorithms.precision import single_precision
from rrl.algorithms.settings import AgentSettings


class EnsembleSettings(AgentSettings):
    """Hyperparameters of algorithms with any number of critics.

    Attributes:
        num_critics: Size of the ensemble.
        target_subset: How many critics, drawn anew for every update, make the target. With 2
            critics, both in the target, the algorithm is as it was published; otherwise it learns
            in the manner of REDQ (Chen et al., 2021).
    """

    num_critics: int = Field(2, ge=1)
    target_subset: int = Field(2, ge=1)

    @property
    def is_ensemble(self) -> bool:
        """Whether there are other than two critics, both of them in the target."""
        return (self.num_critics, self.target_subset) != (2, 2)

    @model_validator(mode="after")
    def _check(self) -> EnsembleSettings:
        if self.target_subset > self.num_critics:
            raise ValueError(
                f"target_subset: expected 1 to num_critics ({self.num_critics}) critics, "
                f"got {self.target_subset}"
            )
        return self


class TD3Settings(EnsembleSettings):
    """Hyperparameters of TD3.

    Attributes:
        policy_delay: Critic updates per update of policy and targets.
        target_noise: Standard deviation of target policy smoothing.
        target_noise_clip: Bound of target policy smoothing.
    """

    policy_delay: int = Field(2, ge=1)
    target_noise: float = Field(0.2, ge=0)
    target_noise_clip: float = Field(0.5, ge=0)


class TD3(Agent):
    """Twin delayed DDPG (Fujimoto et al., 2018), the paper's choice (section III-B).

    Policy *and* targets move on every ``policy_delay``-th update.

    Args:
        inputs: See :class:`Agent`.
        action_size: See :class:`Agent`.
        arguments: ``symmetry``, and the fields of :class:`TD3Settings`.
    """

    Settings: ClassVar[type[AgentSettings]] = TD3Settings
    settings: TD3Settings

    @single_precision()
    def __init__(self, inputs: Any, action_size: int, **arguments: Any) -> None:
        super().__init__(inputs, action_size, **arguments)
        settings = self.settings
        make_loss: Any = TD3Loss
        if settings.is_ensemble:
            make_loss = partial(EnsembleTD3Loss, target_subset=settings.target_subset)
        loss = make_loss(
            self.make_policy(nn.Sequential(self.make_actor(action_size), nn.Tanh())),
            self.make_critics(settings.num_critics),  # a list: each keeps its own initialization
            num_qvalue_nets=settings.num_critics,
            bounds=(-1.0, 1.0),
            policy_noise=settings.target_noise,
            noise_clip=settings.target_noise_clip,
            loss_function=settings.loss_function,
        )
        self.learn_from(loss, loss.qvalue_network_params, loss.actor_network_params)

    def value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the sum of the critics' losses, with ``q_value`` and ``target_value``."""
        loss, info = self.loss.value_loss(batch)
        means = {"q_value": info["pred_value"].mean(), "target_value": info["target_value"].mean()}
        return loss, means

    def actor_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return minus the first critic's value, or an ensemble's mean."""
        return self.loss.actor_loss(batch)[0], {}
