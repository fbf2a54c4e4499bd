"""TD3's and SAC's losses for an ensemble of critics, of which a random few make the target."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictParams
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp
from torchrl.objectives import LossModule, SACLoss, TD3Loss
from torchrl.objectives.sac import compute_rsample_log_prob
from torchrl.objectives.utils import distance_loss

from rrl.algorithms.base import Agent
from rrl.checks import check
from rrl.slot_random import SlotGenerators

__all__ = ["SUBSET", "EnsembleAgent", "EnsembleSACLoss", "EnsembleTD3Loss", "draw_subsets"]

SUBSET = "target_subset"


class EnsembleAgent(Agent):
    """A learner with any number of critics.

    With more than two critics, or a target of fewer than two, it learns in the manner of REDQ (Chen et al., 2021): each
    target is the least of a random subset of the critics, the policy climbs the mean of all. Together with
    ``layer_norm`` and several updates a step that is DroQ (Hiraoka et al., 2022) without its dropout.

    Args:
        num_critics: size of the ensemble; with 2, and both in the target, the algorithm is as it was published.
        target_subset: how many critics, drawn anew for every update, make the target.
        input_sizes, action_size, hyperparameters: see :class:`Agent`.

    """

    def __init__(
        self,
        input_sizes: dict[str, int],
        action_size: int,
        *,
        num_critics: int = 2,
        target_subset: int = 2,
        **hyperparameters: Any,
    ) -> None:
        super().__init__(input_sizes, action_size, **hyperparameters)
        of_all = f"1 to num_critics ({num_critics}) critics"
        check("target_subset", target_subset, of_all, 1 <= target_subset <= num_critics)
        self.num_critics, self.target_subset = num_critics, target_subset

    @property
    def is_ensemble(self) -> bool:
        """Whether there are other than two critics, both of them in the target."""
        return (self.num_critics, self.target_subset) != (2, 2)

    def prepare(self, batches: TensorDictBase) -> None:
        """Draw the critics of each target."""
        if self.target_subset < self.num_critics:
            subsets = draw_subsets(self._noise, len(batches), self.num_critics, self.target_subset)
            batches["next", SUBSET] = subsets.unsqueeze(2).expand(*batches.shape, -1)


class _Ensemble(LossModule):
    """``N`` critics in the manner of REDQ (Chen et al., 2021).

    All critics learn the same target, the least value among the target critics that the batch's ("next",
    "target_subset"), bool ``[S, B, N]``, names (all, where it is missing); the policy climbs the mean of all critics.
    Subsets come as data: drawn in here, from the global generator, they would tie the seeds of a stack together.
    Losses are not reduced, ``[S, B]``; keys and metrics are TorchRL's.
    """

    @abstractmethod
    def _values(self, tensordict: TensorDictBase, params: TensorDictParams) -> Tensor:
        """Every critic's value of the same observations and actions, ``[N, S, B]``."""

    def _least(self, tensordict: TensorDictBase, following: TensorDictBase) -> Tensor:
        """The least of the chosen target critics' values of ``following``, ``[S, B]``."""
        values = self._values(following, self.target_qvalue_network_params)
        subset = tensordict.get(("next", SUBSET), None)
        if subset is not None:
            values = torch.where(subset.movedim(-1, 0), values, torch.inf)
        return values.min(0)[0]

    def _critics_loss(
        self, tensordict: TensorDictBase, worth: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum of the critics' losses where the next states are worth ``worth`` [S, B]."""
        data = tensordict.clone(False)
        data.set(("next", self.value_estimator.tensor_keys.value), worth.unsqueeze(-1))
        target = self.value_estimator.value_estimate(data).squeeze(-1)
        values = self._values(tensordict, self.qvalue_network_params)  # (N, S, B)
        loss = distance_loss(
            values, target.expand_as(values), loss_function=self.loss_function
        ).sum(0)
        return loss, {
            "td_error": (values - target).square().detach(),
            "next_state_value": worth,
            "pred_value": values.detach(),
            "target_value": target,
        }


class EnsembleTD3Loss(_Ensemble, TD3Loss):
    """TorchRL's TD3 with an ensemble; smoothing noise is data too and none is drawn. See :class:`_Ensemble`."""

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the sum of the critics' losses and what TorchRL's loss tells about it."""
        with torch.no_grad():
            worth = self._worth(tensordict)
        return self._critics_loss(tensordict, worth)

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return minus the critics' mean."""
        acting = tensordict.select(*self.actor_network.in_keys, strict=False)
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            acting = self.actor_network(acting)
        values = self._values(acting, self._cached_detach_qvalue_network_params)
        return -values.mean(0), {"state_action_value_actor": values.detach()}

    def _worth(self, tensordict: TensorDictBase) -> Tensor:
        following = step_mdp(tensordict).select(*self.actor_network.in_keys, strict=False)
        with self.target_actor_network_params.to_module(
            self.actor_network, preserve_module_state=False
        ):
            following = self.actor_network(following)
        action = self.tensor_keys.action
        following.set(action, following.get(action).clamp(self.min_action, self.max_action))
        return self._least(tensordict, following)

    def _values(self, tensordict: TensorDictBase, params: TensorDictParams) -> Tensor:
        inputs = tensordict.select(*self.qvalue_network.in_keys).expand(
            self.num_qvalue_nets, *tensordict.batch_size
        )
        return (
            self._vmap_qvalue_network00(inputs, params)
            .get(self.tensor_keys.state_action_value)
            .squeeze(-1)
        )


class EnsembleSACLoss(_Ensemble, SACLoss):
    """TorchRL's SAC with an ensemble. See :class:`_Ensemble`."""

    def qvalue_v2_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the sum of the critics' losses; ``td_error`` is the largest of the critics'."""
        with torch.no_grad():
            following = tensordict.get("next").copy()
            action, log_prob = self._sample(following)
            following.set(self.tensor_keys.action, action)
            worth = self._least(tensordict, following) - self._alpha * log_prob
        loss, info = self._critics_loss(tensordict, worth)
        return loss, {**info, "td_error": info["td_error"].sqrt().max(0)[0]}

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, dict[str, Tensor]]:
        """Return temperature times log-probability minus the critics' mean."""
        action, log_prob = self._sample(tensordict)
        acting = tensordict.select(*self.qvalue_network.in_keys, strict=False).set(
            self.tensor_keys.action, action
        )
        values = self._values(acting, self._cached_detached_qvalue_params)
        return self._alpha * log_prob - values.mean(0), {"log_prob": log_prob.detach()}

    def _sample(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """An action of the policy, and its log-probability."""
        with (
            set_exploration_type(ExplorationType.RANDOM),
            self.actor_network_params.to_module(self.actor_network, preserve_module_state=False),
        ):
            return compute_rsample_log_prob(self.actor_network.get_dist(tensordict))

    def _values(self, tensordict: TensorDictBase, params: TensorDictParams) -> Tensor:
        inputs = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        return (
            self._vmap_qnetworkN0(inputs, params)
            .get(self.tensor_keys.state_action_value)
            .squeeze(-1)
        )


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
