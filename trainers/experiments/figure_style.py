"""How the figures tell arms apart, and what they show of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..metric_names import ACCEPTED, CONTROLLER, is_share
from ..report.learning_curve import RESIDUAL_COLOR

COLORS = (
    RESIDUAL_COLOR,
    *["#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#7a6a00", "#4d4d4d", "#8c2d04"],
)
"""Distinct for the color-blind (Okabe and Ito), and from the controller's."""
MARKERS = "osD^vPX"
"""One less than the colors: the two together tell 56 arms apart. The star is the controller's."""
LINES = ("-", "-.", ":")
"""Of curves, for one round of the colors after the other; dashes are the controller's."""
HATCHES = ("", "///", "...")
"""The same of bars."""
PANELS = {"success": "success rate [%]", "return": "return of an episode"}
"""Entry and title."""
RATES = tuple(prefix + "success" for prefix in ("", CONTROLLER, ACCEPTED))


def color_of(arm: int) -> str:
    """Return the color of an arm by its number; the others of a round have other colors."""
    return COLORS[arm % len(COLORS)]


def marked(arm: int) -> dict[str, Any]:
    """Return color and marker of an arm by its number."""
    return {"color": color_of(arm), "marker": MARKERS[arm % len(MARKERS)]}


def of_round(arm: int, choices: Sequence[str]) -> str:
    """Return what tells an arm from those that have its color: one of ``LINES`` or ``HATCHES``."""
    return choices[arm // len(COLORS) % len(choices)]


def unit_of(entry: str) -> float:
    """Return what an entry is multiplied by to be shown: rates are shown in per cent."""
    return 100.0 if entry in RATES or is_share(entry) else 1.0
