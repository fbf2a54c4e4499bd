"""How the figures tell arms apart, and what they show of them."""

from __future__ import annotations

from ..report.learning_curve import RESIDUAL_COLOR

__all__ = ["COLORS", "MARKERS", "PANELS"]

COLORS = (
    RESIDUAL_COLOR,
    *["#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#7a6a00", "#4d4d4d", "#8c2d04"],
)
"""Distinct for the color-blind (Okabe and Ito), and from the controller's."""
MARKERS = "osD^vPX*"
PANELS = (("success", "success rate [%]", 100.0), ("return", "return of an episode", 1.0))
"""Entry, title and unit; where the first is not reported, the second stands in."""
