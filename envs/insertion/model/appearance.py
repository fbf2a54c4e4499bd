"""What the arm looks like: shapes that touch nothing and weigh nothing."""

from __future__ import annotations

from typing import Any

MATERIALS = {
    "red": {"rgba": (0.66, 0.04, 0.05, 1), "specular": 0.6, "shininess": 0.7},
    "charcoal": {"rgba": (0.09, 0.095, 0.105, 1), "specular": 0.4, "shininess": 0.5},
    "steel": {"rgba": (0.66, 0.68, 0.71, 1), "specular": 0.9, "shininess": 0.8},
    "screen": {"rgba": (0.10, 0.32, 0.45, 1), "specular": 0.9, "shininess": 0.9, "emission": 0.6},
}


def add_materials(root: Any) -> None:
    """Add the arm's materials to an MJCF root."""
    for name, look in MATERIALS.items():
        root.asset.add("material", name=name, **look)


def draw(body: Any, kind: str, material: str, **shape: Any) -> None:
    """Add one decorative geom to ``body``."""
    body.add(
        "geom", type=kind, material=material, contype=0, conaffinity=0, mass=0, group=1, **shape
    )


def mark(body: Any, name: str, **place: Any) -> Any:
    """Add a site that is not seen to ``body``, and return it."""
    return body.add("site", name=name, size=(0.002,), rgba=(0, 0, 0, 0), **place)


def _segment(body: Any, kind: str, material: str, start: Any, end: Any, radius: float) -> None:
    draw(body, kind, material, fromto=(*start, *end), size=(radius,))


def dress_arm(base: Any, links: list[Any]) -> None:
    """Draw base, joint housings, upper arm, forearm and display on the seven links."""
    l0, l1, l2, l3, l4, l5, l6 = links
    _segment(base, "cylinder", "charcoal", (0, 0, -0.02), (0, 0, 0.03), 0.13)
    _segment(base, "cylinder", "steel", (0, 0, 0.03), (0, 0, 0.08), 0.10)

    # Shoulder: a red column leaning out to the second joint, and the display on top.
    _segment(l0, "cylinder", "red", (0, 0, 0), (0, 0, 0.10), 0.098)
    _segment(l0, "capsule", "red", (0.0, 0, 0.10), (0.05, 0.005, 0.235), 0.085)
    _segment(l0, "cylinder", "charcoal", (0.081, -0.03, 0.237), (0.081, 0.055, 0.237), 0.078)
    _segment(l0, "capsule", "charcoal", (0.03, 0, 0.30), (0.03, 0, 0.36), 0.025)
    draw(l0, "box", "charcoal", pos=(0.035, 0, 0.42), size=(0.012, 0.11, 0.075))
    draw(l0, "box", "screen", pos=(0.048, 0, 0.42), size=(0.002, 0.098, 0.063))

    # Upper arm.
    _segment(l1, "cylinder", "red", (0, 0, 0), (0, 0, 0.15), 0.082)
    _segment(l1, "capsule", "red", (0, -0.02, 0.125), (0, -0.14, 0.1425), 0.068)
    _segment(l1, "cylinder", "charcoal", (0, -0.13, 0.1425), (0, -0.152, 0.1425), 0.071)
    _segment(l2, "cylinder", "red", (0, 0, 0.012), (0, 0, 0.20), 0.066)
    _segment(l2, "capsule", "red", (0, 0, 0.17), (0, -0.02, 0.25), 0.064)

    # Elbow and forearm.
    _segment(l3, "cylinder", "charcoal", (0, 0, -0.03), (0, 0, 0.04), 0.066)
    _segment(l3, "cylinder", "red", (0, 0, -0.16), (0, 0, -0.03), 0.064)
    _segment(l3, "capsule", "red", (0, -0.01, -0.125), (0, -0.10, -0.1265), 0.056)
    _segment(l3, "cylinder", "charcoal", (0, -0.115, -0.1265), (0, -0.135, -0.1265), 0.058)
    _segment(l4, "cylinder", "red", (0, 0, 0.01), (0, 0, 0.20), 0.052)
    _segment(l4, "capsule", "red", (0, 0, 0.18), (0, 0.012, 0.268), 0.051)

    # Wrist.
    _segment(l5, "cylinder", "charcoal", (0, 0, -0.035), (0, 0, 0.035), 0.052)
    _segment(l5, "cylinder", "red", (0, 0, 0.035), (0, 0, 0.125), 0.050)
    _segment(l5, "capsule", "red", (0, 0, 0.105), (0, -0.07, 0.1053), 0.044)
    _segment(l5, "cylinder", "charcoal", (0, -0.09, 0.1053), (0, -0.112, 0.1053), 0.046)
    _segment(l6, "cylinder", "steel", (0, 0, 0.0), (0, 0, 0.0245), 0.042)
