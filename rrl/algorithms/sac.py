"""SAC on stacked seeds, built from TorchRL's loss."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictModuleBase,
)
from torch import Tensor, nn
from torchrl.objectives import SACLoss

from rrl.adam import Adam
from rrl.algorithms.base import Agent, check_hyperparameters
from rrl.algorithms.squashed_gaussian import GaussianHead, SquashedGaussian, SquashedGaussianPolicy
from rrl.keys import ACTION
from rrl.networks import StackedMLP
from rrl.random import SlotGenerators

NOISE = "action_noise"
TEMPERATURE = "temperature"
ACTING = "sac_policy"


class SAC(Agent):
    """Soft actor-critic (Haarnoja et al., 2018) for ``S`` independent seeds at once, with learned temperatures.

    The policy is stochastic and explores by itself: combine it with :class:`rrl.exploration.NoExploration`. Its noise,
    in the losses and when acting, comes from one generator a seed; see
    :class:`~rrl.algorithms.squashed_gaussian.SquashedGaussian` for how noise and temperatures enter
    :class:`torchrl.objectives.SACLoss`.

    Args:
        input_sizes: size of each observation entry that actor and critics read, by key.
        action_size: size of the action; the policy's action lies in [-1, 1].
        num_seeds: how many independent learners are stacked.
        seed: learner ``k`` is the learner that ``seed + k`` alone would give.
        hidden: widths of the hidden layers, of actor and critics.
        layer_norm: normalise the critics' hidden layers.
        last_layer_bound: the actor's output layer is drawn from ``U(-bound, bound)``; 0 makes the mean of an untrained
            residual exactly zero.
        initial_std: standard deviation of an untrained policy, before the tanh.
        actor_lr, critic_lr, temperature_lr: learning rates of Adam.
        initial_temperature: weight of the entropy at the start.
        target_entropy: the entropy that the temperature is tuned to, in nats; None: minus the action's size.
        gamma: discount.
        tau: share by which the critics' targets follow.
        policy_delay: critic updates per update of policy and targets.
        critic_burn_in: updates at the start in which the critics learn and the policy waits.
        loss_function: the critics' loss, ``"l2"`` or ``"smooth_l1"``.
        reward_scale: factor on the stored reward before the critics see it.
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
        initial_std: float = 0.3,
        actor_lr: float = 1e-3,
        critic_lr: float = 1e-3,
        temperature_lr: float = 1e-3,
        initial_temperature: float = 0.1,
        target_entropy: float | None = None,
        gamma: float = 0.99,
        tau: float = 0.005,
        policy_delay: int = 1,
        critic_burn_in: int = 0,
        loss_function: str = "l2",
        reward_scale: float = 1.0,
        compiled: bool = False,
    ) -> None:
        check_hyperparameters(gamma, tau)
        if not initial_temperature > 0:
            raise ValueError(f"initial_temperature: expected a number above 0, got {initial_temperature}")
        super().__init__(
            input_sizes,
            action_size,
            num_seeds=num_seeds,
            seed=seed,
            noise=NOISE,
            reward_scale=reward_scale,
            policy_delay=policy_delay,
            critic_burn_in=critic_burn_in,
        )
        self.target_entropy = float(-action_size if target_entropy is None else target_entropy)
        self.log_temperature = nn.Parameter(torch.full((num_seeds, 1), initial_temperature).log())
        self.temperature_optimizer = Adam([self.log_temperature], temperature_lr)
        self.head = GaussianHead(initial_std)
        network = self.make_actor(2 * action_size, hidden, last_layer_bound, squash=False)
        actor = ProbabilisticTensorDictSequential(
            TensorDictModule(nn.Sequential(network, self.head), self.input_keys, ["loc", "scale"]),
            ProbabilisticTensorDictModule(
                in_keys={"loc": "loc", "scale": "scale", "noise": NOISE, "temperature": TEMPERATURE},
                out_keys=[ACTION],
                distribution_class=SquashedGaussian,
                return_log_prob=True,
            ),
        )
        loss = SACLoss(
            actor,
            self.make_critics(2, hidden, layer_norm),
            loss_function=loss_function,
            # SACLoss has one temperature for a whole batch; a stack's are in the distribution
            alpha_init=1.0,
            fixed_alpha=True,
            target_entropy=0.0,
            reduction="none",
            scalar_output_mode="exclude",
        )
        _ = loss.target_entropy  # a buffer made at first use, which a state_dict must hold from the start
        self.learn_from(
            loss,
            loss.qvalue_network_params,
            loss.actor_network_params,
            gamma=gamma,
            tau=tau,
            actor_lr=actor_lr,
            critic_lr=critic_lr,
            compiled=compiled,
        )
        self._acting = SlotGenerators(seed, num_seeds, stream=ACTING)

    @property
    def temperature(self) -> Tensor:
        """Weight of the entropy, ``[S, 1]``."""
        return self.log_temperature.detach().exp()

    @property
    def policy(self) -> TensorDictModuleBase:
        """The stochastic policies of all seeds; deterministic, tanh of the mean, without exploration."""
        return SquashedGaussianPolicy(self._actor, self.head, self.input_keys, self._acting)

    def wrap(self, actor: StackedMLP, seed: int) -> TensorDictModuleBase:
        """Make a stochastic policy with noise of its own."""
        return SquashedGaussianPolicy(
            actor, self.head, self.input_keys, SlotGenerators(seed, actor.num_seeds, stream=ACTING)
        )

    def prepare(self, batches: TensorDictBase) -> None:
        """Draw the noise of the actions that the losses sample."""
        batches[NOISE] = self.draw(batches[ACTION].shape)
        batches["next", NOISE] = self.draw(batches[ACTION].shape)

    def _set_temperature(self, batch: TensorDictBase) -> None:
        temperature = self.temperature.expand(batch.shape)
        batch[TEMPERATURE] = temperature
        batch["next", TEMPERATURE] = temperature

    def value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the sum of the two critics' losses, with ``td_error``."""
        self._set_temperature(batch)
        loss, info = self.loss.qvalue_v2_loss(batch)
        return loss, {"td_error": info["td_error"].mean(-1)}

    def actor_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return temperature times log-probability minus value, and tune the temperatures to the target entropy."""
        loss, info = self.loss.actor_loss(batch.clone(False))  # it writes mean and deviation
        entropy = -(info["log_prob"] / batch[TEMPERATURE]).mean(-1)  # (S,)
        # the gradient of log_temperature * (entropy - target)
        self.temperature_optimizer.step([(entropy - self.target_entropy).unsqueeze(-1)])
        return loss, {"entropy": entropy, "temperature": batch[TEMPERATURE].mean(-1)}

    def get_extra_state(self) -> dict[str, Any]:
        """What a checkpoint needs beyond tensors, with the generators of the acting policy."""
        return super().get_extra_state() | {"acting": self._acting.state_dict()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`."""
        super().set_extra_state(state)
        self._acting.load_state_dict(state["acting"])
