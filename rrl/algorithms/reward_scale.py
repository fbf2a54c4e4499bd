"""The factor from the environment's reward to that of the critics."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from rrl.algorithms.calibration import reward_factor
from rrl.n_step import STEPS

GROWTH = 1.25
"""Rewards that have grown by this factor are scaled anew."""


class RewardScale(nn.Module):
    """A factor on rewards: a given one, or one that is derived and follows rewards that grow.

    A controller that always fails says nothing of what a success is worth. Where rewards have
    grown, the factor shrinks and the critics' last layers with it, so that values keep their
    meaning, as in Pop-Art (van Hasselt et al., 2016).

    Args:
        given: The factor; None: derived.

    Attributes:
        value: The factor, a scalar; 1 until one is derived.
        derives: Whether it is derived.
        known: Whether rewards that are not 0 were seen.
    """

    value: Tensor

    def __init__(self, given: float | None) -> None:
        super().__init__()
        self.derives, self.known = given is None, False
        self.register_buffer("value", torch.tensor(1.0 if given is None else given))

    @torch.no_grad()
    def follow(
        self, transitions: TensorDictBase, gamma: float, loss: nn.Module, last_layer: str
    ) -> None:
        """Take the factor of the first rewards that are not 0, then a smaller one as they grow.

        Args:
            transitions: ``[n]``: all rewards that are learned from, as the environment gave them.
            gamma: Discount.
            loss: Holds the critics, as TorchRL's losses do.
            last_layer: Name of a critic's last layer.
        """
        if not self.derives:
            return
        # Whether rewards are sums of several stands beside them: a successor is never told.
        steps = transitions.get(STEPS, None)
        n_step = 1 if steps is None else int(steps.max())
        factor = reward_factor(transitions["next", "reward"].flatten(), gamma, n_step)
        if factor is None:
            return
        if not self.known:  # of rewards of 0 critics have learned 0, which is right in any unit
            self.known = True
            self.value.fill_(factor)
        elif factor * GROWTH < float(self.value):
            _shrink(loss, last_layer, factor / float(self.value))
            self.value.fill_(factor)

    def copy(self, other: RewardScale) -> None:
        """Go on from another one's factor, if it is not given."""
        if self.derives:
            self.value.copy_(other.value)
            self.known = other.known or not other.derives

    def get_extra_state(self) -> dict[str, Any]:
        """Return what a checkpoint needs beyond tensors."""
        return {"known": self.known}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore :meth:`get_extra_state`."""
        self.known = state["known"]


def _shrink(loss: nn.Module, last_layer: str, share: float) -> None:
    # The whole path: other layers' may end alike. A critic of one layer is its own last one.
    layer = f"value_network_params.module.{last_layer}".rstrip(".")
    for name, values in loss.state_dict().items():
        if name.rpartition(".")[0].endswith(layer):
            values.mul_(share)
