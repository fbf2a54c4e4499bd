"""TD3's and SAC's losses for an ensemble of critics, of which a random few make the target."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, get_args

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp
from torchrl.objectives import SACLoss, TD3Loss
from torchrl.objectives.common import AUTO_LOSS_MASK_KEYS
from torchrl.objectives.sac import compute_rsample_log_prob
from torchrl.objectives.utils import distance_loss

Metrics = dict[str, Tensor]
PolicyValue = Literal["mean", "first", "least"]
"""What the policy climbs: the mean of all critics (REDQ), the first (TD3), the least (SAC)."""
_WITHOUT = {
    "value_network": "the critics' targets stand in for it",
    "skip_done_states": "what follows an end does not count in a target",
}
"""Why arguments of TorchRL's losses are not needed."""


class _Ensemble:
    """``N`` critics in the manner of REDQ (Chen et al., 2021).

    All critics learn the same target, the least value among ``target_subset`` of the target
    critics, drawn anew for every update. Everything else, keys and output included, is TorchRL's.
    It is no ``LossModule`` itself, whose metaclass would give it a ``forward``.
    """

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    def __init__(
        self,
        actor_network: Any,
        qvalue_network: Any,
        *,
        target_subset: int = 2,
        policy_value: PolicyValue = "mean",
        **arguments: Any,
    ) -> None:
        for name, reason in _WITHOUT.items():
            if arguments.get(name):
                raise ValueError(
                    f"{name}: expected none for an ensemble of critics, got a "
                    f"{type(arguments[name]).__name__}; leave it out: {reason}"
                )
        super().__init__(actor_network, qvalue_network, **arguments)  # type: ignore[call-arg]
        if not 1 <= target_subset <= self.num_qvalue_nets:
            raise ValueError(
                f"target_subset: expected 1 to num_qvalue_nets ({self.num_qvalue_nets}) critics, "
                f"got {target_subset}"
            )
        if policy_value not in get_args(PolicyValue):
            choices = ", ".join(get_args(PolicyValue))
            raise ValueError(f"policy_value: expected one of {choices}, got {policy_value!r}")
        self.target_subset, self.policy_value = target_subset, policy_value

    def _values(self, tensordict: TensorDictBase, params: TensorDictBase) -> Tensor:
        """Return every critic's value of the same observations and actions, ``[N, *batch]``."""

        def value(inputs: TensorDictBase, params: TensorDictBase) -> Tensor:
            with params.to_module(self.qvalue_network):
                return self.qvalue_network(inputs).get(self.tensor_keys.state_action_value)

        inputs = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        if self.deactivate_vmap:
            values = torch.stack([value(inputs, critic) for critic in params.unbind(0)])
        else:
            vmapped = torch.vmap(value, (None, 0), randomness=self.vmap_randomness)
            values = vmapped(inputs, params)
        return values.squeeze(-1)

    def _policy_value(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Return what the policy climbs, ``[*batch]``, and the critics' values ``[n, *batch]``."""
        params = self.qvalue_network_params.detach()
        values = self._values(tensordict, params[:1] if self.policy_value == "first" else params)
        return (values.min(0)[0] if self.policy_value == "least" else values.mean(0)), values

    def _least_target(self, following: TensorDictBase) -> Tensor:
        """Return the least value of the drawn target critics, ``[*batch]``."""
        values = self._values(following, self.target_qvalue_network_params)
        if self.target_subset < self.num_qvalue_nets:
            drawn = torch.rand(self.num_qvalue_nets, device=values.device).argsort()
            values = values[drawn[: self.target_subset]]
        return values.min(0)[0]

    def _critics_loss(
        self, tensordict: TensorDictBase, next_value: Tensor
    ) -> tuple[Tensor, Metrics]:
        """Return the sum of the critics' losses where the next states have ``next_value``."""
        after = next_value.unsqueeze(-1)
        target = self.value_estimator.value_estimate(tensordict, next_value=after).squeeze(-1)
        values = self._values(tensordict, self.qvalue_network_params)  # (N, *batch)
        distance = distance_loss(values, target.expand_as(values), self.loss_function).sum(0)
        return self._reduced(distance, tensordict), {
            "td_error": (values - target).square().detach(),
            "next_state_value": next_value,
            "pred_value": values.detach(),
            "target_value": target,
        }

    def _reduced(self, loss: Tensor, tensordict: TensorDictBase) -> Tensor:
        """Reduce a loss ``[*batch]`` as ``reduction`` says.

        Steps count as much as their priority weight, and not at all where they are masked.
        """
        weight = self._weight(loss, tensordict)
        if weight is not None:  # masked steps may hold anything, also what times zero is not zero
            loss = torch.where(weight == 0, 0.0, loss * weight)
        if self.reduction == "none":
            return loss
        if self.reduction == "mean" and weight is not None:
            return loss.sum() / weight.sum().clamp_min(torch.finfo(loss.dtype).tiny)
        return loss.mean() if self.reduction == "mean" else loss.sum()

    def _weight(self, loss: Tensor, tensordict: TensorDictBase) -> Tensor | None:
        """Return how much each step counts, shaped as the loss; None: all count alike.

        Masks and weights are of steps ``[*batch]`` or ``[*batch, 1]``; a loss of several agents has
        a further dimension.
        """
        key, found = self.loss_mask_key, []
        for name in AUTO_LOSS_MASK_KEYS if key == "auto" else [] if key is None else [key]:
            found.append(tensordict.get(name, None))
        if self.use_prioritized_weights:
            found.append(tensordict.get(self.tensor_keys.priority_weight, None))
        weights = []
        for weight in (w for w in found if w is not None):
            flat = weight.squeeze(-1) if weight.ndim > loss.ndim else weight
            further = [1] * (loss.ndim - flat.ndim)
            weights.append(flat.reshape(*flat.shape, *further).expand_as(loss).to(loss))
        return torch.stack(weights).prod(0) if weights else None


class EnsembleTD3Loss(_Ensemble, TD3Loss):
    """:class:`torchrl.objectives.TD3Loss` with an ensemble of critics (REDQ, Chen et al., 2021).

    With two critics, both in the target, and ``policy_value="first"`` it is ``TD3Loss``, but for
    ``state_action_value_actor``, which holds those critics alone that the policy climbs. With
    ``deactivate_vmap=True`` it is one that :func:`torch.compile` can follow.

    Args:
        actor_network: The policy.
        qvalue_network: One critic, or a list of critics that keep their initialization.
        target_subset: How many critics, drawn anew for every update, make the target.
        policy_value: What the policy climbs: ``mean``, ``first`` or ``least`` of the critics.
        arguments: Of ``TD3Loss``; ``num_qvalue_nets`` is the ensemble's size.

    Raises:
        ValueError: If ``target_subset`` is not in 1 to ``num_qvalue_nets``.
    """

    def value_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, Metrics]:
        """Return the sum of the critics' losses and what ``TD3Loss`` tells about it."""
        noise = torch.randn_like(tensordict.get(self.tensor_keys.action)) * self.policy_noise
        with torch.no_grad():
            following = step_mdp(tensordict).select(*self.actor_network.in_keys, strict=False)
            # Otherwise the parameters are left with tensors that a move to a device misses.
            params = self.target_actor_network_params
            with params.to_module(self.actor_network, preserve_module_state=False):
                following = self.actor_network(following)
            action = following.get(self.tensor_keys.action)
            action = action + noise.clamp(-self.noise_clip, self.noise_clip)
            following.set(self.tensor_keys.action, action.clamp(self.min_action, self.max_action))
            next_value = self._least_target(following)
        return self._critics_loss(tensordict, next_value)

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, Metrics]:
        """Return minus the value that the policy climbs."""
        acting = tensordict.select(*self.actor_network.in_keys, strict=False)
        params = self.actor_network_params
        with params.to_module(self.actor_network, preserve_module_state=False):
            acting = self.actor_network(acting)
        value, values = self._policy_value(acting)
        return self._reduced(-value, tensordict), {"state_action_value_actor": values.detach()}


class EnsembleSACLoss(_Ensemble, SACLoss):
    """:class:`torchrl.objectives.SACLoss` with an ensemble of critics (REDQ, Chen et al., 2021).

    With two critics, both in the target, and ``policy_value="least"`` it is ``SACLoss``. With
    ``deactivate_vmap=True`` it is one that :func:`torch.compile` can follow.

    Args:
        actor_network: The stochastic policy.
        qvalue_network: One critic, or a list of critics that keep their initialization.
        target_subset: How many critics, drawn anew for every update, make the target.
        policy_value: What the policy climbs: ``mean``, ``first`` or ``least`` of the critics.
        arguments: Of ``SACLoss``; ``num_qvalue_nets`` is the ensemble's size.

    Raises:
        ValueError: If ``target_subset`` is not in 1 to ``num_qvalue_nets``, or an ensemble does
            not have what is asked for (a ``value_network``, ``skip_done_states``).
    """

    def qvalue_v2_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, Metrics]:
        """Return the sum of the critics' losses; ``td_error`` is the largest of the critics'."""
        with torch.no_grad():
            following = tensordict.get("next").copy()
            action, log_prob = self._sample(following)
            following.set(self.tensor_keys.action, action)
            entropy_bonus = -self._temperature() * log_prob
            next_value = self._least_target(following) + entropy_bonus
        loss, info = self._critics_loss(tensordict, next_value)
        return loss, {**info, "td_error": info["td_error"].sqrt().max(0)[0]}

    def actor_loss(self, tensordict: TensorDictBase) -> tuple[Tensor, Metrics]:
        """Return temperature times log-probability minus the value that the policy climbs."""
        action, log_prob = self._sample(tensordict)
        acting = tensordict.select(*self.qvalue_network.in_keys, strict=False)
        value, _ = self._policy_value(acting.set(self.tensor_keys.action, action))
        loss = self._temperature() * log_prob - value
        return self._reduced(loss, tensordict), {"log_prob": log_prob.detach()}

    def _temperature(self) -> Tensor:
        """Return the entropy's weight, kept within ``min_alpha`` and ``max_alpha``."""
        if self.min_log_alpha is not None or self.max_log_alpha is not None:
            self.log_alpha.data.clamp_(self.min_log_alpha, self.max_log_alpha)
        return self.log_alpha.detach().exp()

    def _sample(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Return an action of the policy and its log-probability."""
        with (
            set_exploration_type(ExplorationType.RANDOM),
            self.actor_network_params.to_module(self.actor_network, preserve_module_state=False),
        ):
            return compute_rsample_log_prob(self.actor_network.get_dist(tensordict))
