"""How a quantity that an environment writes is reported, and kept."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from rrl.transforms.episode_value import REDUCTIONS

from .checked import Checked

__all__ = ["Metric"]

Reduction = Literal["max", "min", "mean", "sum", "last"]


class Metric(Checked):
    """How a quantity that the environment writes under ``("metrics", NAME)`` is reported, and kept.

    Attributes:
        unit: The unit, for axes and tables.
        reduce: How the steps of an episode become its one value.
        budget: What the mean over episodes shall not exceed: the learner keeps to it
            (:mod:`.training.constraints`), and evaluations say whether it was met. None: any value.
        limit: What no episode should exceed: evaluations count those that do. It is kept by a
            safety limit, not by learning.
    """

    model_config = ConfigDict(frozen=True)

    unit: str = ""
    reduce: Reduction = "mean"
    budget: Annotated[float, Field(gt=0)] | None = None
    limit: float | None = None

    @property
    def bounds(self) -> dict[str, float]:
        """What an episode's value is compared with: ``budget`` and ``limit``, where given."""
        given = {"budget": self.budget, "limit": self.limit}
        return {name: bound for name, bound in given.items() if bound is not None}

    def _check(self) -> None:
        if self.budget is not None and self.reduce not in REDUCTIONS:
            raise ValueError(
                f"budget: expected one of {', '.join(REDUCTIONS)} as reduce, of which a step has a "
                f"share of its own, got {self.reduce!r}; give the sum a budget instead"
            )
