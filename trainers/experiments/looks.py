"""How the figures tell arms apart, and what they show of them."""

from __future__ import annotations

from ..metric_names import ACCEPTED, CONTROLLER, is_share
from ..report.learning_curve import RESIDUAL_COLOR

COLORS = (
    RESIDUAL_COLOR,
    *["#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#7a6a00", "#4d4d4d", "#8c2d04"],
)
"""Distinct for the color-blind (Okabe and Ito), and from the controller's."""
MARKERS = "osD^vPX*"
PANELS = {"success": "success rate [%]", "return": "return of an episode"}
"""Entry and title."""
RATES = tuple(prefix + "success" for prefix in ("", CONTROLLER, ACCEPTED))


def unit_of(entry: str) -> float:
    """Return what an entry is multiplied by to be shown: rates are shown in per cent."""
    return 100.0 if entry in RATES or is_share(entry) else 1.0
