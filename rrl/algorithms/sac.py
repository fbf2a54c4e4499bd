"""SAC on stacked seeds, built from TorchRL's loss."""

from __future__ import annotations

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

from rrl.algorithms.adam import Adam
from rrl.algorithms.ensemble import EnsembleAgent, EnsembleSACLoss
from rrl.algorithms.networks import StackedMLP
from rrl.algorithms.squashed_gaussian import GaussianHead, SquashedGaussian, SquashedGaussianPolicy
from rrl.algorithms.symmetric_actor import SymmetricActor
from rrl.checks import check
from rrl.keys import ACTION
from rrl.slot_random import SlotGenerators

NOISE = "action_noise"
TEMPERATURE = "temperature"
ACTING = "sac_policy"


class SAC(EnsembleAgent):
    """Soft actor-critic (Haarnoja et al., 2018) for ``S`` independent seeds at once, with learned temperatures.

    The policy is stochastic and explores by itself: combine it with :class:`rrl.exploration.NoExploration`. Its noise,
    in the losses and when acting, comes from one generator a seed; see
    :class:`~rrl.algorithms.squashed_gaussian.SquashedGaussian` for how noise and temperatures enter
    :class:`torchrl.objectives.SACLoss`.

    Args:
        initial_std: standard deviation of an untrained policy, before the tanh.
        temperature_lr: learning rate of the temperatures.
        initial_temperature: weight of the entropy at the start.
        target_entropy: the entropy that the temperature is tuned to, in nats; None: minus the action's size.
        input_sizes, action_size, hyperparameters: see :class:`EnsembleAgent`.

    """

    stream = NOISE

    def __init__(
        self,
        input_sizes: dict[str, int],
        action_size: int,
        *,
        initial_std: float = 0.3,
        temperature_lr: float = 1e-3,
        initial_temperature: float = 0.1,
        target_entropy: float | None = None,
        **hyperparameters: Any,
    ) -> None:
        super().__init__(input_sizes, action_size, **hyperparameters)
        check(
            "initial_temperature", initial_temperature, "a number above 0", initial_temperature > 0
        )
        self.target_entropy = float(-action_size if target_entropy is None else target_entropy)
        self.log_temperature = nn.Parameter(
            torch.full((self.num_seeds, 1), initial_temperature).log()
        )
        self.temperature_optimizer = Adam([self.log_temperature], temperature_lr)
        self.head = GaussianHead(initial_std)
        make_loss = EnsembleSACLoss if self.is_ensemble else SACLoss
        loss = make_loss(
            self._make_stochastic_actor(),
            self.make_critics(self.num_critics),
            num_qvalue_nets=self.num_critics,
            loss_function=self.loss_function,
            # SACLoss has one temperature for a whole batch; a stack's are in the distribution
            alpha_init=1.0,
            fixed_alpha=True,
            target_entropy=0.0,
            reduction="none",
            scalar_output_mode="exclude",
        )
        _ = (
            loss.target_entropy
        )  # a buffer made at first use, which a state_dict must hold from the start
        self.learn_from(loss, loss.qvalue_network_params, loss.actor_network_params)
        self._acting = SlotGenerators(self.seed, self.num_seeds, stream=ACTING)

    def _make_stochastic_actor(self) -> ProbabilisticTensorDictSequential:
        network = self.make_actor(2 * self.action_size, squash=False)
        return ProbabilisticTensorDictSequential(
            TensorDictModule(nn.Sequential(network, self.head), self.input_keys, ["loc", "scale"]),
            ProbabilisticTensorDictModule(
                in_keys={
                    "loc": "loc",
                    "scale": "scale",
                    "noise": NOISE,
                    "temperature": TEMPERATURE,
                },
                out_keys=[ACTION],
                distribution_class=SquashedGaussian,
                return_log_prob=True,
            ),
        )

    @property
    def temperature(self) -> Tensor:
        """Weight of the entropy, ``[S, 1]``."""
        return self.log_temperature.detach().exp()

    @property
    def policy(self) -> TensorDictModuleBase:
        """The stochastic policies of all seeds; deterministic, tanh of the mean, without exploration."""
        return SquashedGaussianPolicy(
            self._symmetric(self._actor), self.head, self.input_keys, self._acting
        )

    def wrap(self, actor: StackedMLP | SymmetricActor, seed: int) -> TensorDictModuleBase:
        """Make a stochastic policy with noise of its own."""
        return SquashedGaussianPolicy(
            actor, self.head, self.input_keys, SlotGenerators(seed, actor.num_seeds, stream=ACTING)
        )

    def prepare(self, batches: TensorDictBase) -> None:
        """Draw the noise of the actions that the losses sample, and the critics of each target."""
        batches[NOISE] = self.draw(batches[ACTION].shape)
        batches["next", NOISE] = self.draw(batches[ACTION].shape)
        super().prepare(batches)

    def _set_temperature(self, batch: TensorDictBase) -> None:
        temperature = self.temperature.expand(batch.shape)
        batch[TEMPERATURE] = temperature
        batch["next", TEMPERATURE] = temperature

    def value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the sum of the critics' losses, with ``td_error``."""
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
