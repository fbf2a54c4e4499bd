"""The held block and the standing blocks with one angled corner, as composer entities."""

from __future__ import annotations

from typing import Any

import numpy as np
from dm_control import composer, mjcf

Vector3 = tuple[float, float, float]


def chamfered_vertices(half_size: Vector3, chamfer: tuple[float, float], side: int) -> np.ndarray:
    """Corners of a box whose top edge on ``side`` (+1 or -1 along x) is cut, [10, 3] or [8, 3], m."""
    size_x, size_y, size_z = half_size
    cut_x, cut_z = chamfer
    outline = [(-side * size_x, -size_z), (side * size_x, -size_z), (-side * size_x, size_z)]
    if cut_x > 0:
        outline += [(side * size_x, size_z - cut_z), (side * (size_x - cut_x), size_z)]
    else:
        outline += [(side * size_x, size_z)]
    return np.array([(x, y, z) for x, z in outline for y in (-size_y, size_y)])


class StandingBlock(composer.Entity):
    """A block that stands on the platform and whose inner top edge is cut, so that it guides."""

    def _build(
        self,
        name: str,
        half_size: Vector3,
        chamfer: tuple[float, float],
        inner_side: int,
        mass: float,
        friction: float,
        rgba: tuple[float, ...],
    ) -> None:
        """Builds the block.

        Args:
            name: of the MJCF model.
            half_size: of the box before the cut, m.
            chamfer: cut along x and z, m.
            inner_side: +1 where the gap is at larger x than the block, else -1.
            mass: kg.
            friction: sliding friction.
            rgba: colour.
        """
        self._root = mjcf.RootElement(model=name)
        self._root.compiler.angle = "radian"
        vertices = chamfered_vertices(half_size, chamfer, inner_side)
        mesh = self._root.asset.add("mesh", name="prism", vertex=vertices.ravel(), inertia="convex")
        material = self._root.asset.add(
            "material", name="surface", rgba=rgba, specular=0.3, shininess=0.3
        )
        self._geom = self._root.worldbody.add(
            "geom", name="prism", type="mesh", mesh=mesh, mass=mass, material=material,
            friction=(friction, 0.005, 0.0001),
        )  # fmt: skip

    @property
    def mjcf_model(self) -> Any:
        """Root of the block's MJCF."""
        return self._root

    @property
    def geom(self) -> Any:
        """The prism."""
        return self._geom


class HeldBlock(composer.Entity):
    """The block in the hand. Its frame is its top face's centre, z pointing down into the block."""

    def _build(
        self,
        half_size: Vector3,
        mass: float,
        friction: float,
        rgba: tuple[float, ...],
        name: str = "held_block",
    ) -> None:
        """Builds the block.

        Args:
            half_size: m.
            mass: kg.
            friction: sliding friction.
            rgba: colour.
            name: of the MJCF model.
        """
        self._root = mjcf.RootElement(model=name)
        self._root.compiler.angle = "radian"
        material = self._root.asset.add(
            "material", name="surface", rgba=rgba, specular=0.3, shininess=0.3
        )
        self._body = self._root.worldbody.add(
            "body", name="center", pos=(0, 0, half_size[2]), gravcomp=1
        )
        self._geom = self._body.add(
            "geom", name="box", type="box", size=half_size, mass=mass, material=material,
            friction=(friction, 0.005, 0.0001),
        )  # fmt: skip
        # Turned by pi about z: its x axis is the world's in the arm's posture TOOL_DOWN.
        self._center_site = self._body.add(
            "site", name="center", quat=(0, 0, 0, 1), size=(0.002,), rgba=(0, 0, 0, 0)
        )
        # A touch sensor sums the normal forces of the contacts inside its site's volume.
        self._skin_site = self._body.add(
            "site",
            name="skin",
            type="box",
            size=tuple(1.1 * np.array(half_size)),
            rgba=(0, 0, 0, 0),
        )

    @property
    def mjcf_model(self) -> Any:
        """Root of the block's MJCF."""
        return self._root

    @property
    def body(self) -> Any:
        """The block, frame at its centre."""
        return self._body

    @property
    def geom(self) -> Any:
        """The box."""
        return self._geom

    @property
    def center_site(self) -> Any:
        """The tool's centre: the middle of the block."""
        return self._center_site

    @property
    def skin_site(self) -> Any:
        """A volume around the block for the touch sensor."""
        return self._skin_site
