"""TD3 on stacked seeds, built from TorchRL's loss."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor

from rrl.algorithms.ensemble import EnsembleAgent, EnsembleTD3Loss
from rrl.checks import check
from rrl.keys import ACTION

SMOOTHING = "target_smoothing"


class TargetSmoothing(TensorDictModuleBase):
    """Add the noise found under ``target_smoothing`` to the action; without it, do nothing.

    TD3 perturbs its target policy's action. :class:`torchrl.objectives.TD3Loss` draws that noise from the global
    generator, which would tie the seeds of a stack together; as data in the batch's ``next`` it belongs to one seed,
    can be replayed, and costs a compiled update no generator. The loss clips the sum to the action bounds.
    """

    in_keys = (ACTION, SMOOTHING)
    out_keys = (ACTION,)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the perturbed ``action``."""
        noise = tensordict.get(SMOOTHING, None)
        if noise is not None:
            tensordict.set(ACTION, tensordict.get(ACTION) + noise)
        return tensordict


class TwinTD3Loss(EnsembleTD3Loss):
    """TorchRL's TD3 itself, without what it computes and throws away.

    :class:`torchrl.objectives.TD3Loss` evaluates both critics for the policy's loss, and differentiates both, to use
    the first; and draws smoothing noise from the global generator even where it is multiplied by 0.
    """

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return minus the first critic's value."""
        acting = tensordict.select(*self.actor_network.in_keys, strict=False)
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            acting = self.actor_network(acting)
        with (
            self.qvalue_network_params[0]
            .detach()
            .to_module(self.qvalue_network, preserve_module_state=False)
        ):
            value = self.qvalue_network(acting).get(self.tensor_keys.state_action_value).squeeze(-1)
        return -value, {"state_action_value_actor": value.detach()}


class TD3(EnsembleAgent):
    """Twin delayed DDPG (Fujimoto et al., 2018) for ``S`` independent seeds at once.

    The paper's choice of algorithm (section III-B). Policy *and* targets move on every ``policy_delay``-th update.

    Args:
        policy_delay: critic updates per update of policy and targets.
        target_noise, target_noise_clip: standard deviation and bound of target policy smoothing.
        residual_penalty: weight of the mean squared action in the policy's loss, in units of the critics' value.
        input_sizes, action_size, hyperparameters: see :class:`EnsembleAgent`.

    """

    stream = SMOOTHING

    def __init__(
        self,
        input_sizes: dict[str, int],
        action_size: int,
        *,
        policy_delay: int = 2,
        target_noise: float = 0.2,
        target_noise_clip: float = 0.5,
        residual_penalty: float = 0.0,
        **hyperparameters: Any,
    ) -> None:
        super().__init__(input_sizes, action_size, policy_delay=policy_delay, **hyperparameters)
        check("target_noise", target_noise, "a standard deviation of 0 or more", target_noise >= 0)
        check(
            "target_noise_clip", target_noise_clip, "a bound of 0 or more", target_noise_clip >= 0
        )
        check("residual_penalty", residual_penalty, "a weight of 0 or more", residual_penalty >= 0)
        self.target_noise, self.target_noise_clip = target_noise, target_noise_clip
        self.residual_penalty = residual_penalty
        actor = TensorDictModule(
            self.make_actor(action_size, squash=True), self.input_keys, [ACTION]
        )
        make_loss = EnsembleTD3Loss if self.is_ensemble else TwinTD3Loss
        loss = make_loss(
            TensorDictSequential(actor, TargetSmoothing()),
            # a list keeps each critic's own initialisation: TD3Loss would redraw copies of a single one
            self.make_critics(self.num_critics),
            num_qvalue_nets=self.num_critics,
            bounds=(-1.0, 1.0),
            policy_noise=0.0,  # see TargetSmoothing
            loss_function=self.loss_function,
            reduction="none",
        )
        self.learn_from(loss, loss.qvalue_network_params, loss.actor_network_params)

    def prepare(self, batches: TensorDictBase) -> None:
        """Draw the noise of target policy smoothing and the critics of each target."""
        batches["next", SMOOTHING] = self._draw_smoothing(batches[ACTION].shape)
        super().prepare(batches)

    def _draw_smoothing(self, shape: torch.Size) -> Tensor:
        clip = self.target_noise_clip
        return (self.draw(shape) * self.target_noise).clamp_(-clip, clip)

    def value_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the sum of the critics' losses, with ``q_value`` and ``target_value``."""
        loss, info = self.loss.value_loss(batch)
        return loss, {
            "q_value": info["pred_value"].mean((0, -1)),
            "target_value": info["target_value"].mean(-1),
        }

    def actor_loss(self, batch: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return minus the first critic's value, or an ensemble's mean, plus penalty, with ``residual_square``."""
        loss = self.loss.actor_loss(batch)[0]
        if not self.residual_penalty:
            return loss, {}
        square = self._actor(*(batch[key] for key in self.input_keys)).square().mean(-1)
        return loss + self.residual_penalty * square, {"residual_square": square.detach().mean(-1)}
