"""Which metrics are looked at, under which title: one list for the report and for the W&B dashboard."""

from __future__ import annotations

import math
from dataclasses import dataclass

FOLLOWED = "{followed}"
"""Stands in a metric's name for the scenario that is evaluated during training."""

ANY = (-math.inf, math.inf)
RATE = (0.0, 1.0)


@dataclass(frozen=True)
class Panel:
    """One small chart over environment steps.

    Attributes:
        metric: the metric's name, with ``{followed}`` for a scenario.
        title: what it shows, with its unit.
        unit: factor from the logged value to the drawn one.
        bounds: the values possible; an interval does not leave them.
        controller: metric of the controller alone on the same episodes.
    """

    metric: str
    title: str
    unit: float = 1.0
    bounds: tuple[float, float] = ANY
    controller: str = ""


def _evaluated(metric: str, title: str, *, rate: bool = False, paired: bool = True) -> Panel:
    unit, bounds = (100.0, RATE) if rate else (1.0, ANY)
    controller = f"eval/{FOLLOWED}/controller_{metric}" if paired else ""
    return Panel(f"eval/{FOLLOWED}/{metric}", title, unit, bounds, controller)


LEARNING = (
    _evaluated("success", "success rate [%]", rate=True),
    _evaluated("return", "return of an episode"),
)
CHANGES = (
    _evaluated(
        "rescue_rate", "rescued: only the residual solves them [%]", rate=True, paired=False
    ),
    _evaluated(
        "regression_rate", "broken: only the controller solves them [%]", rate=True, paired=False
    ),
)
SHARES = (
    Panel("action/residual_share", "residual's share of the action [%]", 100.0, RATE),
    Panel("action/residual_rms", "residual, root mean square [action units]"),
    Panel("action/clip_fraction", "components clipped at the action's bounds [%]", 100.0, RATE),
)
CONTACT = (
    _evaluated("peak_contact_force", "largest contact force of an episode [N]"),
    _evaluated("peak_tilt", "largest tilt of an episode [rad]"),
    _evaluated("episode_length", "control steps of an episode"),
)
