"""A sequential test that a policy is not worse than the controller, and the error of many of them.

The test is a bet (Waudby-Smith and Ramdas, 2024). Let ``d`` in [-1, 1] be the policy's result less
the controller's in an episode. Whoever does not believe that the mean of ``d`` is ``-margin`` or
less puts a share of a wealth of 1 on ``d + margin`` being positive. If the policy is worse than
the margin allows, the wealth does not grow on average, whatever was bet and whenever one looks; it
ever reaches ``1 / alpha`` with a probability of at most ``alpha`` (Ville, 1939). Nothing is assumed
of ``d`` but that the episodes are drawn alike and apart: pairs of equal episodes make the test
quicker, not valid.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BETS = 0.999 * np.array([0.25, 0.5, 0.75, 1.0])
"""Shares of the largest bet that cannot ruin; the wealth is the mean over one gambler each."""
FUTILITY = 0.2
"""Probability, at most, of giving up on a policy that is as good as the controller."""
STAKE = 0.25
"""Share of the error that is left, for the next candidate."""


def margin_unit(returns: Sequence[float] | NDArray[np.float64]) -> float:
    """Return what a margin in returns is a share of: the range of the controller's.

    Where it always gets the same return, that return's size stands in; then 1. Returns that are not
    finite say nothing.
    """
    values = np.asarray(returns, dtype=float).ravel()
    values = values[np.isfinite(values)]
    return float(np.ptp(values)) or float(np.abs(values).max()) or 1.0 if len(values) else 1.0


class NotWorseTest:
    """Tests whether a policy is worse than the controller by ``margin`` or more.

    Args:
        margin: Above 0 and below 1.
        alpha: Probability, at most, of accepting a policy that is.

    Attributes:
        episodes: How many differences it took to decide, or so far.
    """

    def __init__(self, margin: float, alpha: float) -> None:
        self.margin, self.alpha, self.episodes = margin, alpha, 0
        self._for, self._against = np.ones(len(BETS)), np.ones(len(BETS))

    @property
    def wealth(self) -> float:
        """What has become of a wealth of 1 that was bet on the policy."""
        return float(self._for.mean())

    @property
    def accepted(self) -> bool:
        """Whether the policy is shown not to be worse."""
        return self.wealth >= 1 / self.alpha

    @property
    def decided(self) -> bool:
        """Whether it is accepted, or shown to be below the controller: more would be in vain."""
        return self.accepted or float(self._against.mean()) >= 1 / FUTILITY

    def add(self, differences: Sequence[float] | NDArray[np.float64]) -> None:
        """Take further episodes in order, up to the decision.

        Args:
            differences: Policy less controller ``[n]``. What is no number, such as the return of a
                diverged simulation, counts as -1; what is beyond -1 or 1 counts as these.
        """
        if self.decided or not len(differences):
            return
        d = np.clip(np.nan_to_num(np.asarray(differences, dtype=float), nan=-1.0), -1.0, 1.0)
        bets = BETS / (1 - self.margin)
        gains = self._for * np.cumprod(1 + bets * (d[:, None] + self.margin), axis=0)  # (n, bets)
        doubts = self._against * np.cumprod(1 - BETS * d[:, None], axis=0)
        ends = (gains.mean(axis=1) >= 1 / self.alpha) | (doubts.mean(axis=1) >= 1 / FUTILITY)
        last = int(ends.argmax()) if ends.any() else len(d) - 1
        self._for, self._against = gains[last], doubts[last]
        self.episodes += last + 1


class ErrorBudget:
    """Shares the error ``alpha`` of a run among as many candidates as come.

    A candidate stakes a part of what is left. It gets back what its test was worth: all of it when
    it is accepted, its share of the wealth when it is not. With a false acceptance counted as 1,
    what is left never grows on average, so that the probability of any false acceptance is at most
    ``alpha``, however many candidates there are and whatever made them.

    Args:
        alpha: Of the whole run.

    Attributes:
        left: What is left of it.
    """

    def __init__(self, alpha: float) -> None:
        self.left = alpha

    def test(self, margin: float) -> NotWorseTest:
        """Return the test of the next candidate."""
        return NotWorseTest(margin, STAKE * self.left)

    def settle(self, test: NotWorseTest) -> None:
        """Take the stake of a test that is over, or not gone on with."""
        if not test.accepted:
            self.left -= test.alpha * (1 - min(1.0, test.wealth))
