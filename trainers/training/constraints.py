"""Budgets of quantities, kept by what a step is charged for them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from rrl.algorithms import Multiplier
from rrl.keys import SO_FAR
from rrl.n_step import STEPS

from ..loggers import metrics as names
from ..metric import Metric
from ..settings import ConstraintSettings


def budgets(metrics: Mapping[str, Metric], settings: ConstraintSettings | None) -> dict[str, float]:
    """Return the budgets that a learner keeps to, by the quantity's name."""
    given = {name: metric.budget for name, metric in metrics.items()}
    return {n: b for n, b in given.items() if b is not None and settings is not None}


class Constraints:
    """Keeps the mean over episodes of every quantity with a budget within it.

    Each budget has a Lagrange multiplier, the price of using it up once, in the units of the
    critics' values. It rises with every collected episode that exceeds the budget, and falls, down
    to zero, with every one that does not. The reward that critics see is

        (r - sum_i multiplier_i * change_i / budget_i) / (1 + sum_i multiplier_i)

    where a change is by how much a transition's steps raised the value of its episode so far
    (:class:`~rrl.transforms.EpisodeValue`). What is stored is neither the price nor the reward less
    it, so that old transitions are charged at today's price, and no algorithm knows of constraints.
    The division keeps values from growing with the price (Stooke et al., *Responsive safety in
    reinforcement learning by PID Lagrangian methods*, 2020).

    Without a budget everything is left as it is.

    Args:
        metrics: What the environment reports, by name, some of it with a budget.
        settings: How multipliers adapt; None keeps no budget.
        n_step: How many rewards a transition sums.

    Raises:
        ValueError: If a last value has a budget and ``n_step`` is above 1: what a step changes in
            it the next one changes again, so that a sum over both does not say what it has cost.
    """

    def __init__(
        self, metrics: Mapping[str, Metric], settings: ConstraintSettings | None, n_step: int
    ) -> None:
        kept = budgets(metrics, settings)
        last = [name for name in kept if metrics[name].reduce == "last"]
        if last and n_step > 1:
            raise ValueError(
                f"trainer.n_step: expected 1 with a budget for the last value of {last[0]}, got "
                f"{n_step}; set it to 1, or take the metric's max or sum"
            )
        self.multipliers: dict[str, Multiplier] = {}
        if settings is not None:
            for name, budget in kept.items():
                self.multipliers[name] = Multiplier(budget, settings.rate, settings.initial)

    def adapt(self, transitions: TensorDictBase) -> dict[str, float]:
        """Let the multipliers see the episodes that end in what was stored.

        Args:
            transitions: ``[n]`` in the order of time.

        Returns:
            Metrics of every constraint.
        """
        values: dict[str, float] = {}
        if not self.multipliers:
            return values
        ends = transitions["next", "done"].flatten()  # of transitions that begin with a last step
        if (steps := transitions.get(STEPS, None)) is not None:
            ends = ends & (steps.flatten() == 1)
        for name, multiplier in self.multipliers.items():
            episodes = transitions["next", SO_FAR, name].flatten()[ends].double()
            for value in episodes.tolist():
                multiplier.adapt(value)
            values[names.name(names.CONSTRAINT, name, "multiplier")] = multiplier.value
            if len(episodes):
                values[names.name(names.CONSTRAINT, name, "episode")] = float(episodes.mean())
        return values

    def charge(self, batches: TensorDictBase, reward_scale: Tensor) -> TensorDictBase:
        """Return transitions with the price of what they used taken from the reward.

        Args:
            batches: ``[k, B]``.
            reward_scale: Factor from the reward to that of the critics.
        """
        if not self.multipliers:
            return batches
        price = torch.zeros_like(batches["next", "reward"])
        for name, multiplier in self.multipliers.items():
            change = batches["next", SO_FAR, name] - batches[SO_FAR, name]
            price += multiplier.value / multiplier.budget * change
        weight = 1.0 + sum(multiplier.value for multiplier in self.multipliers.values())
        charged = batches.exclude(SO_FAR, ("next", SO_FAR))
        reward = batches["next", "reward"] - price / reward_scale
        charged["next", "reward"] = reward / weight
        return charged

    def state_dict(self) -> dict[str, Any]:
        """Return the multipliers."""
        return {name: multiplier.value for name, multiplier in self.multipliers.items()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore :meth:`state_dict`."""
        for name, multiplier in self.multipliers.items():
            multiplier.value = float(state[name])
