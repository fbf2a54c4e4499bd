"""Targets within what rewards can add up to."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import LossModule
from torchrl.objectives.value import TD0Estimator


class BoundedTD0Estimator(TD0Estimator):
    """TorchRL's TD(0) target, kept within what the rewards seen so far can add up to.

    An episode that its time limit cuts off ends in a state that no transition starts from, so that
    nothing corrects the critics' value of it. Where they extrapolate to it from the states before,
    each target lets both grow, and a single such episode can end a run. Rewards between ``a`` and
    ``b`` add up to no less than ``a / (1 - gamma)`` and no more than ``b / (1 - gamma)``; after an
    end nothing is added, so that 0 is possible too. A target beyond is an error of the critics.

    Args:
        arguments: Of ``TD0Estimator``.

    Attributes:
        least: Smallest possible value of what was seen, a scalar.
        most: Largest possible value of what was seen, a scalar.
    """

    SEEN: ClassVar[tuple[str, ...]] = ("least", "most")
    """Names of the buffers, which begin at 0."""
    least: Tensor
    most: Tensor

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        for name in self.SEEN:
            self.register_buffer(name, torch.zeros_like(self.gamma))

    def value_estimate(
        self, tensordict: TensorDictBase, *arguments: Any, **settings: Any
    ) -> Tensor:
        """Return the targets ``[*batch, 1]``, after a look at the rewards."""
        target = super().value_estimate(tensordict, *arguments, **settings)
        self._see(tensordict)
        return target.clamp(*self._bounds())

    def _bounds(self) -> tuple[Tensor, Tensor]:
        return self.least, self.most

    def _see(self, tensordict: TensorDictBase) -> None:
        reward = tensordict.get(("next", self.tensor_keys.reward))
        steps = tensordict.get(self.tensor_keys.steps_to_next_obs, None)
        discount = self.gamma if steps is None else self.gamma ** steps.view_as(reward)
        _widen(self.least, self.most, reward / (1.0 - discount))


class SoftBoundedTD0Estimator(BoundedTD0Estimator):
    """The same for soft values, which hold a price on the policy's entropy beside the rewards.

    Args:
        arguments: Of ``TD0Estimator``.

    Attributes:
        least_bonus: Smallest bonus seen, a scalar, at most 0.
        most_bonus: Largest bonus seen, a scalar, at least 0.
    """

    SEEN = (*BoundedTD0Estimator.SEEN, "least_bonus", "most_bonus")
    least_bonus: Tensor
    most_bonus: Tensor

    def grant(self, bonus: Tensor) -> None:
        """Widen the bounds by what is added to the value of every next state, of any shape."""
        _widen(self.least_bonus, self.most_bonus, bonus)

    def _bounds(self) -> tuple[Tensor, Tensor]:
        following = self.gamma / (1.0 - self.gamma)  # bonuses of all steps but the first
        least, most = super()._bounds()
        return least + following * self.least_bonus, most + following * self.most_bonus


@torch.no_grad()
def _widen(least: Tensor, most: Tensor, values: Tensor) -> None:
    """Let two scalars, in place, hold the extremes of ``values`` too."""
    low, high = torch.aminmax(values)
    least.copy_(torch.minimum(least, low))
    most.copy_(torch.maximum(most, high))


def bound_values(loss: LossModule, kind: type[BoundedTD0Estimator] = BoundedTD0Estimator) -> None:
    """Bound the TD(0) targets of one of TorchRL's losses, whose estimator was made."""
    plain: Any = loss.value_estimator
    bounded = kind(gamma=float(plain.gamma), value_network=plain.value_network)
    keys = ("value", "reward", "done", "terminated", "steps_to_next_obs")
    bounded.set_keys(**{key: getattr(plain.tensor_keys, key) for key in keys})
    loss.make_value_estimator(bounded)
