"""The held block and the standing blocks with one angled corner, as composer entities."""

from __future__ import annotations

from typing import Any

import numpy as np
from dm_control import composer, mjcf

from .appearance import mark

Vector3 = tuple[float, float, float]


def chamfered_vertices(half_size: Vector3, chamfer: tuple[float, float], side: int) -> np.ndarray:
    """Return the corners [10 or 8, 3] of a box with the top edge cut on ``side`` of x, +1 or -1."""
    size_x, size_y, size_z = half_size
    cut_x, cut_z = chamfer
    outline = [(-side * size_x, -size_z), (side * size_x, -size_z), (-side * size_x, size_z)]
    if cut_x > 0:
        outline += [(side * size_x, size_z - cut_z), (side * (size_x - cut_x), size_z)]
    else:
        outline += [(side * size_x, size_z)]
    return np.array([(x, y, z) for x, z in outline for y in (-size_y, size_y)])


def _begun(name: str, rgba: tuple[float, ...]) -> tuple[Any, Any]:
    """Return the root of a block's MJCF, and its material."""
    root = mjcf.RootElement(model=name)
    root.compiler.angle = "radian"
    look = {"rgba": rgba, "specular": 0.3, "shininess": 0.3}
    return root, root.asset.add("material", name="surface", **look)


class StandingBlock(composer.ModelWrapperEntity):
    """A block that stands on the platform and whose inner top edge is cut, so that it guides.

    Attributes:
        geom: The prism.
    """

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
        """Build the block.

        Args:
            name: Name of the MJCF model.
            half_size: Half size of the box before the cut [m].
            chamfer: Cut along x and z [m].
            inner_side: +1 where the gap is at larger x than the block, else -1.
            mass: Mass [kg].
            friction: Coefficient of sliding friction.
            rgba: Color.
        """
        root, material = _begun(name, rgba)
        super()._build(root)
        vertices = chamfered_vertices(half_size, chamfer, inner_side)
        mesh = root.asset.add("mesh", name="prism", vertex=vertices.ravel(), inertia="convex")
        self.geom = root.worldbody.add(
            "geom", name="prism", type="mesh", mesh=mesh, mass=mass, material=material,
            friction=(friction, 0.005, 0.0001),
        )  # fmt: skip


class HeldBlock(composer.ModelWrapperEntity):
    """The block in the hand. Its frame is its top face's center, z pointing down into the block.

    Attributes:
        body: The block, frame at its center.
        geom: The box.
        center_site: The tool's center: the middle of the block.
        skin_site: A volume around the block for the touch sensor.
    """

    def _build(
        self,
        half_size: Vector3,
        mass: float,
        friction: float,
        rgba: tuple[float, ...],
        name: str = "held_block",
    ) -> None:
        """Build the block; arguments as in :class:`StandingBlock`."""
        root, material = _begun(name, rgba)
        super()._build(root)
        self.body = root.worldbody.add("body", name="center", pos=(0, 0, half_size[2]), gravcomp=1)
        self.geom = self.body.add(
            "geom", name="box", type="box", size=half_size, mass=mass, material=material,
            friction=(friction, 0.005, 0.0001),
        )  # fmt: skip
        # Turned by pi about z: its x axis is the world's in the arm's posture TOOL_DOWN.
        self.center_site = mark(self.body, "center", quat=(0, 0, 0, 1))
        # A touch sensor sums the normal forces of the contacts inside its site's volume.
        size = tuple(1.1 * np.array(half_size))
        self.skin_site = self.body.add(
            "site", name="skin", type="box", size=size, rgba=(0, 0, 0, 0)
        )
