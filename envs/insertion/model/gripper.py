"""The electric parallel gripper as a composer entity, closed on a block of given width."""

from __future__ import annotations

from typing import Any

from dm_control import composer, mjcf

from .appearance import add_materials, draw

MASS = 0.3
FINGER_TRAVEL = 0.0208
"""Of each finger, m."""
PAD_HALF_SIZE = (0.0035, 0.004, 0.0165)
GRIP_DEPTH = 0.109
"""Distance of the grip point from the hand's frame along its z axis, m."""


class ParallelGripper(composer.Entity):
    """Two fingers that close along the hand's x axis, held at the width of the block between them.

    The block is fixed in the hand (it is already grasped when an episode starts), so the fingers have
    no joints; their pads take part in contacts.
    """

    def _build(self, opening: float, name: str = "gripper") -> None:
        """Builds the gripper.

        Args:
            opening: distance between the pads, m, at most twice the finger travel.
            name: of the MJCF model.
        """
        if not 0 < opening <= 2 * FINGER_TRAVEL:
            raise ValueError(
                f"the gripper opens to {2 * FINGER_TRAVEL:.4f} m, too little for a block "
                f"{opening:.4f} m wide (twice the x of held_half_size)"
            )
        self._root = mjcf.RootElement(model=name)
        self._root.compiler.angle = "radian"
        add_materials(self._root)
        self._body = self._root.worldbody.add("body", name="body", gravcomp=1)
        self._body.add("inertial", pos=(0, 0, 0.04), mass=MASS, diaginertia=(3e-4, 3e-4, 2e-4))
        draw(self._body, "cylinder", "charcoal", fromto=(0, 0, 0, 0, 0, 0.022), size=(0.04,))
        draw(self._body, "box", "charcoal", pos=(0, 0, 0.042), size=(0.056, 0.022, 0.022))
        draw(self._body, "box", "steel", pos=(0, 0, 0.066), size=(0.052, 0.012, 0.003))
        for side in (-1, 1):
            self._add_finger(side, opening)
        self._grip_site = self._body.add(
            "site", name="grip", pos=(0, 0, GRIP_DEPTH), size=(0.002,), rgba=(0, 0, 0, 0)
        )

    def _add_finger(self, side: int, opening: float) -> None:
        pad_x = side * (opening / 2 + PAD_HALF_SIZE[0])
        draw(
            self._body, "box", "steel",
            pos=(pad_x + side * 0.004, 0, 0.080), size=(0.006, 0.009, 0.016),
        )  # fmt: skip
        self._body.add(
            "geom",
            name=f"pad_{'left' if side < 0 else 'right'}",
            type="box",
            pos=(pad_x, 0, GRIP_DEPTH),
            size=PAD_HALF_SIZE,
            mass=0,
            material="charcoal",
        )

    @property
    def mjcf_model(self) -> Any:
        """Root of the gripper's MJCF."""
        return self._root

    @property
    def grip_site(self) -> Any:
        """Point between the pads, z along the approach direction."""
        return self._grip_site
