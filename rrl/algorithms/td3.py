"""TD3 on stacked seeds, built from TorchRL's loss."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor
from torchrl.objectives import TD3Loss

from rrl.algorithms.base import Agent, check_hyperparameters
from rrl.algorithms.ensemble import SUBSET, EnsembleTD3Loss, draw_subsets
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


class TD3(Agent):
    """Twin delayed DDPG (Fujimoto et al., 2018) for ``S`` independent seeds at once.

    The paper's choice of algorithm (section III-B). Policy *and* targets move on every ``policy_delay``-th update.
    With more critics, or a target of fewer, it learns in the manner of REDQ (Chen et al., 2021): each target is the
    least of a random subset of the critics, the policy climbs the mean of all. Together with ``layer_norm`` and several
    updates a step that is DroQ (Hiraoka et al., 2022) without its dropout.

    Args:
        input_sizes: size of each observation entry that actor and critics read, by key.
        action_size: size of the action; the policy's action lies in [-1, 1].
        num_seeds: how many independent learners are stacked.
        seed: learner ``k`` is the learner that ``seed + k`` alone would give.
        hidden: widths of the hidden layers, of actor and critics.
        layer_norm: normalise the critics' hidden layers.
        last_layer_bound: the actor's output layer is drawn from ``U(-bound, bound)``; 0 makes an
            untrained residual exactly zero.
        actor_lr, critic_lr: learning rates of Adam.
        gamma: discount.
        tau: share by which the targets follow.
        policy_delay: critic updates per update of policy and targets.
        critic_burn_in: updates at the start in which the critics learn and the policy waits.
        target_noise, target_noise_clip: standard deviation and bound of target policy smoothing.
        num_critics: size of the ensemble; with 2, and both in the target, it is TD3 itself.
        target_subset: how many critics, drawn anew for every update, make the target.
        residual_penalty: weight of the mean squared action in the policy's loss, in units of the critics' value.
        loss_function: the critics' loss, ``"l2"`` (the paper's code) or ``"smooth_l1"``.
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
        actor_lr: float = 1e-3,
        critic_lr: float = 1e-3,
        gamma: float = 0.99,
        tau: float = 0.005,
        policy_delay: int = 2,
        critic_burn_in: int = 0,
        target_noise: float = 0.2,
        target_noise_clip: float = 0.5,
        num_critics: int = 2,
        target_subset: int = 2,
        residual_penalty: float = 0.0,
        loss_function: str = "l2",
        reward_scale: float = 1.0,
        compiled: bool = False,
    ) -> None:
        check_hyperparameters(gamma, tau)
        if target_noise < 0 or target_noise_clip < 0:
            raise ValueError(
                "target_noise and target_noise_clip: expected values of 0 or more, got "
                f"{target_noise} and {target_noise_clip}"
            )
        if not 1 <= target_subset <= num_critics:
            raise ValueError(
                f"target_subset: expected 1 to num_critics ({num_critics}) critics in the target, got {target_subset}"
            )
        if residual_penalty < 0:
            raise ValueError(f"residual_penalty: expected a weight of 0 or more, got {residual_penalty}")
        super().__init__(
            input_sizes,
            action_size,
            num_seeds=num_seeds,
            seed=seed,
            noise=SMOOTHING,
            reward_scale=reward_scale,
            policy_delay=policy_delay,
            critic_burn_in=critic_burn_in,
        )
        self.target_noise, self.target_noise_clip = target_noise, target_noise_clip
        self.num_critics, self.target_subset = num_critics, target_subset
        self.residual_penalty = residual_penalty
        actor = self.make_actor(action_size, hidden, last_layer_bound, squash=True)
        make_loss = TD3Loss if (num_critics, target_subset) == (2, 2) else EnsembleTD3Loss
        loss = make_loss(
            TensorDictSequential(
                TensorDictModule(actor, in_keys=self.input_keys, out_keys=[ACTION]),
                TargetSmoothing(),
            ),
            # a list keeps each critic's own initialisation: TD3Loss would redraw copies of a single one
            self.make_critics(num_critics, hidden, layer_norm),
            num_qvalue_nets=num_critics,
            bounds=(-1.0, 1.0),
            policy_noise=0.0,  # see TargetSmoothing
            loss_function=loss_function,
            reduction="none",
        )
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

    def prepare(self, batches: TensorDictBase) -> None:
        """Draw the noise of target policy smoothing and the critics of each target."""
        batches["next", SMOOTHING] = self._draw_smoothing(batches[ACTION].shape)
        if self.target_subset < self.num_critics:
            subsets = draw_subsets(self._noise, len(batches), self.num_critics, self.target_subset)
            batches["next", SUBSET] = subsets.unsqueeze(2).expand(*batches.shape, -1)

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
