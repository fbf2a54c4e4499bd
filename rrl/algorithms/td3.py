"""TD3 on stacked seeds, built from TorchRL's loss."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.objectives import SoftUpdate, TD3Loss
from torchrl.objectives.utils import ValueEstimators

from rrl.adam import Adam
from rrl.compilation import compile_update
from rrl.keys import ACTION
from rrl.networks import StackedMLP
from rrl.random import SlotGenerators

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


class TD3(nn.Module):
    """Twin delayed DDPG (Fujimoto et al., 2018) for ``S`` independent seeds at once.

    The paper's choice of algorithm (section III-B). Policy *and* targets move on every ``policy_delay``-th update.

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
        target_noise, target_noise_clip: standard deviation and bound of target policy smoothing.
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
        target_noise: float = 0.2,
        target_noise_clip: float = 0.5,
        loss_function: str = "l2",
        reward_scale: float = 1.0,
        compiled: bool = False,
    ) -> None:
        super().__init__()
        _check_hyperparameters(gamma, tau, policy_delay, target_noise, target_noise_clip)
        self.input_keys = list(input_sizes)
        self.num_seeds = num_seeds
        self.policy_delay = policy_delay
        self.target_noise, self.target_noise_clip = target_noise, target_noise_clip
        self.reward_scale = reward_scale

        in_size = sum(input_sizes.values())
        generators = [torch.Generator().manual_seed(seed + k) for k in range(num_seeds)]
        self._actor_arguments: dict[str, Any] = {
            "in_features": in_size,
            "out_features": action_size,
            "hidden": list(hidden),
            "last_layer_bound": last_layer_bound,
            "squash": True,
        }
        actor = StackedMLP(num_seeds, generators=generators, **self._actor_arguments)
        critics = [
            StackedMLP(
                num_seeds,
                in_size + action_size,
                1,
                list(hidden),
                layer_norm=layer_norm,
                generators=generators,
            )
            for _ in range(2)
        ]
        self.loss = TD3Loss(
            TensorDictSequential(
                TensorDictModule(actor, in_keys=self.input_keys, out_keys=[ACTION]),
                TargetSmoothing(),
            ),
            # a list keeps each critic's own initialisation: TD3Loss would redraw copies of a single one
            [
                TensorDictModule(critic, in_keys=[*self.input_keys, ACTION], out_keys=["state_action_value"])
                for critic in critics
            ],
            bounds=(-1.0, 1.0),
            policy_noise=0.0,  # see TargetSmoothing
            loss_function=loss_function,
            reduction="none",
        )
        self.loss.make_value_estimator(ValueEstimators.TD0, gamma=gamma)
        self.soft_update = SoftUpdate(self.loss, tau=tau)
        self._critic_params = list(self.loss.qvalue_network_params.values(True, True))
        self._actor_params = list(self.loss.actor_network_params.values(True, True))
        self.critic_optimizer = Adam(self._critic_params, critic_lr)
        self.actor_optimizer = Adam(self._actor_params, actor_lr)
        self._smoothing = SlotGenerators(seed, num_seeds, stream=SMOOTHING)
        self._actor = actor
        steps = self._critic_step, self._critic_and_policy_step
        self._steps = [compile_update(step) for step in steps] if compiled else steps
        self.num_updates = 0

    @property
    def policy(self) -> TensorDictModule:
        """The deterministic policies of all seeds: input keys ``[S * E, ...]`` to ``action`` in [-1, 1]."""
        return TensorDictModule(self._actor, in_keys=self.input_keys, out_keys=[ACTION])

    def policy_of(self, k: int) -> TensorDictModule:
        """A copy of seed ``k``'s policy that accepts any batch size."""
        generators = [torch.Generator()]
        actor = StackedMLP(1, generators=generators, **self._actor_arguments)
        actor.load_state_dict({n: p[k : k + 1] for n, p in self._actor.state_dict().items()})
        return TensorDictModule(actor, in_keys=self.input_keys, out_keys=[ACTION])

    def update(self, batches: TensorDictBase) -> dict[str, Tensor]:
        """Take one gradient step per batch.

        Args:
            batches: ``[k, S, B]``, with the input keys, ``action``, and in ``next`` the input keys, ``reward``,
                ``done`` and ``terminated``; changed in place.

        Returns:
            Means over the ``k`` updates, ``[S]`` each: ``loss_critic``, ``q_value``, ``target_value``,
            and ``loss_actor`` (absent while no policy update was due).
        """
        k = batches.shape[0]
        following = batches["next"]
        following["reward"] = following["reward"] * self.reward_scale
        following[SMOOTHING] = self._draw_smoothing(batches[ACTION].shape)
        sums: dict[str, Tensor] = {}
        counts: dict[str, int] = {}
        for i in range(k):
            self.num_updates += 1
            step = self._steps[self.num_updates % self.policy_delay == 0]
            for name, value in step(batches[i]).items():
                sums[name] = sums.get(name, 0.0) + value
                counts[name] = counts.get(name, 0) + 1
        return {name: sums[name] / counts[name] for name in sums}

    def _draw_smoothing(self, shape: torch.Size) -> Tensor:
        k, _, batch, size = shape
        noise = self._smoothing.normal((k, batch, size))  # (S, k, B, n_act)
        clip = self.target_noise_clip
        return (noise * self.target_noise).clamp_(-clip, clip).transpose(0, 1)

    def _critic_step(self, batch: TensorDictBase) -> dict[str, Tensor]:
        loss, info = self.loss.value_loss(batch)
        loss = loss.mean(-1)  # (S,): the sum over seeds below leaves their gradients apart
        self.critic_optimizer.step(torch.autograd.grad(loss.sum(), self._critic_params))
        return {
            "loss_critic": loss.detach(),
            "q_value": info["pred_value"].mean((0, -1)),
            "target_value": info["target_value"].mean(-1),
        }

    def _critic_and_policy_step(self, batch: TensorDictBase) -> dict[str, Tensor]:
        metrics = self._critic_step(batch)
        loss, _ = self.loss.actor_loss(batch)
        loss = loss.mean(-1)
        self.actor_optimizer.step(torch.autograd.grad(loss.sum(), self._actor_params))
        self.soft_update.step()
        return metrics | {"loss_actor": loss.detach()}

    def get_extra_state(self) -> dict[str, Any]:
        """What a checkpoint needs beyond tensors: the update counter and the smoothing noise's generators."""
        return {"num_updates": self.num_updates, "smoothing": self._smoothing.state_dict()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`."""
        self.num_updates = state["num_updates"]
        self._smoothing.load_state_dict(state["smoothing"])


def _check_hyperparameters(
    gamma: float, tau: float, policy_delay: int, target_noise: float, target_noise_clip: float
) -> None:
    if not 0 <= gamma < 1:
        raise ValueError(f"gamma: expected a discount in [0, 1), got {gamma}")
    if not 0 < tau <= 1:
        raise ValueError(f"tau: expected a share in (0, 1], got {tau}")
    if policy_delay < 1:
        raise ValueError(f"policy_delay: expected at least 1 update, got {policy_delay}")
    if target_noise < 0 or target_noise_clip < 0:
        raise ValueError(
            "target_noise and target_noise_clip: expected values of 0 or more, got "
            f"{target_noise} and {target_noise_clip}"
        )
