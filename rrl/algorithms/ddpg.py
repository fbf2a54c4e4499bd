"""DDPG on stacked seeds, built from TorchRL's loss."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.objectives import DDPGLoss

from rrl.algorithms.base import Agent, check_hyperparameters
from rrl.keys import ACTION


class DDPG(Agent):
    """Deep deterministic policy gradient (Lillicrap et al., 2016) for ``S`` independent seeds at once.

    One critic, no smoothing, no delay: what TD3 improves on.

    Args:
        input_sizes: size of each observation entry that actor and critic read, by key.
        action_size: size of the action; the policy's action lies in [-1, 1].
        num_seeds: how many independent learners are stacked.
        seed: learner ``k`` is the learner that ``seed + k`` alone would give.
        hidden: widths of the hidden layers, of actor and critic.
        layer_norm: normalise the critic's hidden layers.
        last_layer_bound: the actor's output layer is drawn from ``U(-bound, bound)``; 0 makes an
            untrained residual exactly zero.
        actor_lr, critic_lr: learning rates of Adam.
        gamma: discount.
        tau: share by which the targets follow.
        policy_delay: critic updates per update of policy and targets.
        critic_burn_in: updates at the start in which the critic learns and the policy waits.
        loss_function: the critic's loss, ``"l2"`` or ``"smooth_l1"``.
        reward_scale: factor on the stored reward before the critic sees it.
        compiled: compile the whole update into one graph.
    """

    def __init__(
        self,
        input_sizes: dict[str, int],
        action_size: int,
        *,
        num_seeds: int = 1,
        seed: int = 0,
        hidden: Sequence[int] = (256, 256),
        layer_norm: bool = False,
        last_layer_bound: float = 0.0,
        actor_lr: float = 1e-3,
        critic_lr: float = 1e-3,
        gamma: float = 0.99,
        tau: float = 0.005,
        policy_delay: int = 1,
        critic_burn_in: int = 0,
        loss_function: str = "l2",
        reward_scale: float = 1.0,
        compiled: bool = False,
    ) -> None:
        check_hyperparameters(gamma, tau)
        super().__init__(
            input_sizes,
            action_size,
            num_seeds=num_seeds,
            seed=seed,
            noise="ddpg",
            reward_scale=reward_scale,
            policy_delay=policy_delay,
            critic_burn_in=critic_burn_in,
        )
        actor = self.make_actor(action_size, hidden, last_layer_bound, squash=True)
        (critic,) = self.make_critics(1, hidden, layer_norm)
        loss = DDPGLoss(
            TensorDictModule(actor, in_keys=self.input_keys, out_keys=[ACTION]),
            critic,
            loss_function=loss_function,
            delay_actor=True,
            delay_value=True,
            reduction="none",
        )
        self.learn_from(
            loss,
            loss.value_network_params,
            loss.actor_network_params,
            gamma=gamma,
            tau=tau,
            actor_lr=actor_lr,
            critic_lr=critic_lr,
            compiled=compiled,
        )

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
