"""DDPG, from TorchRL's loss."""

from __future__ import annotations

from typing import Any

from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.objectives import DDPGLoss

from rrl.algorithms.base import Agent
from rrl.algorithms.precision import single_precision


class DDPG(Agent):
    """Deep deterministic policy gradient (Lillicrap et al., 2016): what TD3 improves on.

    Args:
        inputs: See :class:`Agent`.
        action_size: See :class:`Agent`.
        arguments: ``symmetry``, and the fields of :class:`~rrl.algorithms.base.AgentSettings`.
    """

    @single_precision()
    def __init__(self, inputs: Any, action_size: int, **arguments: Any) -> None:
        super().__init__(inputs, action_size, **arguments)
        if self.readings.learn:
            raise ValueError(
                "encoder: expected one that learns nothing, because TorchRL's DDPGLoss passes no "
                "gradient to it; use TD3 (num_critics=1 and target_subset=1 is the nearest), or SAC"
            )
        loss = DDPGLoss(
            self.make_policy(nn.Sequential(self.make_actor(action_size), nn.Tanh())),
            self.make_critics(1)[0],
            loss_function=self.settings.loss_function,
            delay_actor=True,
            delay_value=True,
        )
        self.learn_from(loss, loss.value_network_params, loss.actor_network_params)

    def value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the critic's loss, with ``q_value`` and ``target_value``."""
        loss, info = self.loss.loss_value(batch)
        means = {
            "q_value": info["pred_value"].detach().mean(),
            "target_value": info["target_value"].mean(),
        }
        return loss, means

    def actor_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return minus the critic's value."""
        return self.loss.loss_actor(batch)[0], {}
