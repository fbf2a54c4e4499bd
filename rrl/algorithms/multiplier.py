"""The price of a constraint."""

from __future__ import annotations

import math

from rrl.checks import check


class Multiplier:
    """A Lagrange multiplier that finds the price at which a mean keeps to its budget.

    Dual ascent, one step for every sample c of what has the budget b:

        lambda <- max(0, lambda + rate * (c / b - 1))

    It is at rest where the mean of c is b, or at zero with a mean below b.

    Args:
        budget: b, positive.
        rate: Size of a step, positive.
        initial: lambda at the start, at least 0.

    Attributes:
        value: lambda.

    Raises:
        ValueError: If a number is not positive or finite, or ``initial`` is negative.
    """

    def __init__(self, budget: float, rate: float, initial: float = 0.0) -> None:
        check("budget", budget, "a positive number", 0 < budget < math.inf)
        check("rate", rate, "a positive number", 0 < rate < math.inf)
        check("initial", initial, "a number of at least 0", 0 <= initial < math.inf)
        self.budget, self.rate, self.value = float(budget), float(rate), float(initial)

    def adapt(self, sample: float) -> None:
        """Take one step.

        Raises:
            ValueError: If the sample is not finite, which no price follows from.
        """
        check("sample", sample, "a finite number", math.isfinite(sample))
        self.value = max(0.0, self.value + self.rate * (sample / self.budget - 1.0))
