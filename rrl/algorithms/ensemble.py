"""TD3's losses for an ensemble of critics, of which a random few make the target."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import step_mdp
from torchrl.objectives import TD3Loss
from torchrl.objectives.utils import distance_loss

from rrl.random import SlotGenerators

__all__ = ["SUBSET", "EnsembleTD3Loss", "draw_subsets"]

SUBSET = "target_subset"


class EnsembleTD3Loss(TD3Loss):
    """TorchRL's TD3 with ``N`` critics in the manner of REDQ (Chen et al., 2021).

    All critics learn the same target, the least value among the target critics that the batch's ("next",
    "target_subset"), bool ``[S, B, N]``, names (all, where it is missing); the policy climbs the mean of all critics.
    Subsets come as data: drawn in here, from the global generator, they would tie the seeds of a stack together.
    Smoothing noise is data too and none is drawn. Losses are not reduced, ``[S, B]``; keys and metrics are TorchRL's.
    """

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the sum of the critics' losses and what TorchRL's loss tells about it."""
        with torch.no_grad():
            following = self._target(tensordict)  # (S, B)
        data = tensordict.clone(False)
        data.set(("next", self.tensor_keys.state_action_value), following.unsqueeze(-1))
        target = self.value_estimator.value_estimate(data).squeeze(-1)
        values = self._values(tensordict, self.qvalue_network_params)  # (N, S, B)
        loss = distance_loss(values, target.expand_as(values), loss_function=self.loss_function).sum(0)
        return loss, {
            "td_error": (values - target).square().detach(),
            "next_state_value": following,
            "pred_value": values.detach(),
            "target_value": target,
        }

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return minus the critics' mean."""
        acting = tensordict.select(*self.actor_network.in_keys, strict=False)
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            acting = self.actor_network(acting)
        values = self._values(acting, self._cached_detach_qvalue_network_params)
        return -values.mean(0), {"state_action_value_actor": values.detach()}

    def _target(self, tensordict: TensorDictBase) -> Tensor:
        following = step_mdp(tensordict).select(*self.actor_network.in_keys, strict=False)
        with self.target_actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            following = self.actor_network(following)
        action = self.tensor_keys.action
        following.set(action, following.get(action).clamp(self.min_action, self.max_action))
        values = self._values(following, self.target_qvalue_network_params)
        subset = tensordict.get(("next", SUBSET), None)
        if subset is not None:
            values = torch.where(subset.movedim(-1, 0), values, torch.inf)
        return values.min(0)[0]

    def _values(self, tensordict: TensorDictBase, params: TensorDictBase) -> Tensor:
        """Every critic's value of the same observations and actions, ``[N, S, B]``."""
        inputs = tensordict.select(*self.qvalue_network.in_keys).expand(self.num_qvalue_nets, *tensordict.batch_size)
        return self._vmap_qvalue_network00(inputs, params).get(self.tensor_keys.state_action_value).squeeze(-1)


def draw_subsets(generators: SlotGenerators, k: int, num_critics: int, size: int) -> Tensor:
    """Draw which critics make each update's target: bool ``[k, S, N]`` with ``size`` of the ``N`` true.

    Args:
        generators: one a seed.
        k: number of updates.
        num_critics: size ``N`` of the ensemble.
        size: critics in a subset, from 1 to ``N``.

    """
    ranks = generators.uniform((k, num_critics)).argsort(-1).argsort(-1)  # (S, k, N)
    return (ranks < size).transpose(0, 1)
