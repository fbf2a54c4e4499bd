"""DDPG on stacked seeds, built from TorchRL's loss."""

from __future__ import annotations

from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.objectives import DDPGLoss

from rrl.algorithms.base import Agent
from rrl.keys import ACTION


class DDPG(Agent):
    """Deep deterministic policy gradient (Lillicrap et al., 2016) for ``S`` independent seeds at once.

    One critic, no smoothing, no delay: what TD3 improves on.

    Args:
        input_sizes, action_size, hyperparameters: see :class:`Agent`.

    """

    stream = "ddpg"

    def __init__(
        self, input_sizes: dict[str, int], action_size: int, **hyperparameters: Any
    ) -> None:
        super().__init__(input_sizes, action_size, **hyperparameters)
        actor = self.make_actor(action_size, squash=True)
        (critic,) = self.make_critics(1)
        loss = DDPGLoss(
            TensorDictModule(actor, in_keys=self.input_keys, out_keys=[ACTION]),
            critic,
            loss_function=self.loss_function,
            delay_actor=True,
            delay_value=True,
            reduction="none",
        )
        self.learn_from(loss, loss.value_network_params, loss.actor_network_params)

    def value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the critic's loss, with ``q_value`` and ``target_value``."""
        loss, info = self.loss.loss_value(batch)
        return loss, {
            "q_value": info["pred_value"].detach().mean(-1),
            "target_value": info["target_value"].mean(-1),
        }

    def actor_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return minus the critic's value."""
        return self.loss.loss_actor(batch)[0], {}
