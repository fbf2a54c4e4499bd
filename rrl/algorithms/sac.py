"""SAC, from TorchRL's loss."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, ClassVar

import torch
from pydantic import Field
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import (
    InteractionType,
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import Tensor, nn
from torchrl.data import TensorSpec
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import TanhNormal
from torchrl.objectives import SACLoss
from torchrl.objectives.sac import compute_rsample_log_prob

from rrl.algorithms.base import Agent
from rrl.algorithms.ensemble import EnsembleSACLoss
from rrl.algorithms.precision import single_precision
from rrl.algorithms.settings import AgentSettings
from rrl.algorithms.td3 import EnsembleSettings
from rrl.algorithms.value_bounds import BoundedTD0Estimator, SoftBoundedTD0Estimator
from rrl.keys import ACTION

LOG_STD_RANGE = (-5.0, 2.0)
DISTRIBUTION_KEYS = {"loc": "_loc", "scale": "_scale"}


class SACSettings(EnsembleSettings):
    """Hyperparameters of SAC.

    Attributes:
        initial_std: Standard deviation of an untrained policy, before the tanh.
        temperature_lr: Learning rate of the temperature.
        initial_temperature: Weight of the entropy at the start.
        target_entropy: The entropy that the temperature is tuned to [nat]; None: minus the action's
            size.
    """

    initial_std: float = Field(0.3, ge=math.exp(LOG_STD_RANGE[0]), le=math.exp(LOG_STD_RANGE[1]))
    temperature_lr: float = Field(1e-3, gt=0)
    initial_temperature: float = Field(0.1, gt=0)
    target_entropy: float | None = None


class _MeanAndDeviation(nn.Module):
    """Splits a network's output ``[*batch, 2 m]`` into mean and standard deviation."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, *inputs: Tensor) -> tuple[Tensor, Tensor]:
        loc, log_std = self.network(*inputs).chunk(2, -1)
        return loc, log_std.clamp(*LOG_STD_RANGE).exp()


class SAC(Agent):
    """Soft actor-critic (Haarnoja et al., 2018) with a learned temperature.

    The policy is stochastic and explores by itself; without exploration it is the tanh of the mean.

    Args:
        inputs: See :class:`Agent`.
        action_size: See :class:`Agent`.
        arguments: ``symmetry``, and the fields of :class:`SACSettings`.
    """

    Settings: ClassVar[type[AgentSettings]] = SACSettings
    settings: SACSettings
    bounded_targets: ClassVar[type[BoundedTD0Estimator]] = SoftBoundedTD0Estimator
    temperature_optimizer: Any

    @single_precision()
    def __init__(self, inputs: Any, action_size: int, **arguments: Any) -> None:
        super().__init__(inputs, action_size, **arguments)
        settings = self.settings
        network = self.make_actor(2 * action_size)
        layer: Any = network.get_submodule(self._action_layer)
        if (bias := layer.bias) is None:
            raise ValueError(
                "network: expected an output layer with a bias, which holds initial_std, got "
                f"{layer}; give it one, or use another algorithm"
            )
        with torch.no_grad():
            bias[action_size:] += math.log(settings.initial_std)
        target = settings.target_entropy
        make_loss: Any = SACLoss
        if settings.is_ensemble:
            make_loss = partial(EnsembleSACLoss, target_subset=settings.target_subset)
        loss = make_loss(
            self.make_policy(network),
            self.make_critics(settings.num_critics),
            num_qvalue_nets=settings.num_critics,
            loss_function=settings.loss_function,
            alpha_init=settings.initial_temperature,
            target_entropy=float(-action_size if target is None else target),
        )
        _ = loss.target_entropy  # made at first use, but a state_dict must hold it from the start
        self.learn_from(loss, loss.qvalue_network_params, loss.actor_network_params)
        self.temperature_optimizer = settings.optimizer(
            [loss.log_alpha], lr=settings.temperature_lr
        )

    def actor_module(self, network: nn.Module, keys: list[NestedKey]) -> Any:
        """Return the module from ``keys`` to ``action``, which it draws."""
        return ProbabilisticTensorDictSequential(
            TensorDictModule(_MeanAndDeviation(network), keys, list(DISTRIBUTION_KEYS.values())),
            ProbabilisticTensorDictModule(
                in_keys=DISTRIBUTION_KEYS,
                out_keys=[ACTION],
                distribution_class=TanhNormal,
                distribution_kwargs={"safe_tanh": False},
                default_interaction_type=InteractionType.RANDOM,
            ),
        )

    def value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the sum of the critics' losses, with ``td_error``."""
        if self.settings.value_bounds and self.policy_waits:
            self._look_ahead(batch["next"])
        loss, info = self.loss.qvalue_v2_loss(batch)
        return loss, {"td_error": info["td_error"].mean()}

    @torch.no_grad()
    def _look_ahead(self, following: TensorDictBase) -> None:
        """Grant the entropies of a policy that waits; its own updates draw them anyway."""
        loss: Any = self.loss
        with (
            set_exploration_type(ExplorationType.RANDOM),
            loss.actor_network_params.to_module(loss.actor_network, preserve_module_state=False),
        ):
            acting = loss.actor_network.get_dist(following.select(*self.read_keys))
            _, log_prob = compute_rsample_log_prob(acting)
        loss.value_estimator.grant(-loss.log_alpha.exp() * log_prob)

    def actor_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the policy's loss, and tune the temperature to the target entropy."""
        loss, info = self.loss.actor_loss(batch.clone(False))  # it writes mean and deviation
        temperature = self.loss.log_alpha.detach().exp()
        if self.settings.value_bounds:
            self.loss.value_estimator.grant(-temperature * info["log_prob"].detach())
        tuning = self.loss.alpha_loss(info["log_prob"]).mean()
        self.temperature_optimizer.step(torch.autograd.grad(tuning, [self.loss.log_alpha]))
        return loss, {"entropy": -info["log_prob"].mean(), "temperature": temperature}


def no_exploration(spec: TensorSpec) -> None:
    """Make no exploration module: for policies that are stochastic themselves, such as SAC's."""
