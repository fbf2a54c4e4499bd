"""The electric parallel gripper as a composer entity, closed on a block of given width."""

from __future__ import annotations

from dm_control import composer, mjcf

from .appearance import add_materials, draw, mark

MASS = 0.3
FINGER_TRAVEL = 0.0208
"""Of each finger, m."""
PAD_HALF_SIZE = (0.0035, 0.004, 0.0165)
GRIP_DEPTH = 0.109
"""Distance of the grip point from the hand's frame along its z axis, m."""


class ParallelGripper(composer.ModelWrapperEntity):
    """Two fingers that close along the hand's x axis, held at the width of the block between them.

    The block is fixed in the hand (it is already grasped when an episode starts), so the fingers
    have no joints; their pads take part in contacts.

    Attributes:
        grip_site: Point between the pads, z along the approach direction.
    """

    def _build(self, opening: float, name: str = "gripper") -> None:
        """Build the gripper.

        Args:
            opening: Distance between the pads [m], at most twice the finger travel.
            name: Name of the MJCF model.
        """
        if not 0 < opening <= 2 * FINGER_TRAVEL:
            raise ValueError(
                "held_half_size: expected a block at most as wide along x as the gripper opens, "
                f"{2 * FINGER_TRAVEL:.4f} m, got {opening:.4f} m"
            )
        root = mjcf.RootElement(model=name)
        super()._build(root)
        root.compiler.angle = "radian"
        add_materials(root)
        body = root.worldbody.add("body", name="body", gravcomp=1)
        body.add("inertial", pos=(0, 0, 0.04), mass=MASS, diaginertia=(3e-4, 3e-4, 2e-4))
        draw(body, "cylinder", "charcoal", fromto=(0, 0, 0, 0, 0, 0.022), size=(0.04,))
        draw(body, "box", "charcoal", pos=(0, 0, 0.042), size=(0.056, 0.022, 0.022))
        draw(body, "box", "steel", pos=(0, 0, 0.066), size=(0.052, 0.012, 0.003))
        for side, name in ((-1, "pad_left"), (1, "pad_right")):
            pad_x = side * (opening / 2 + PAD_HALF_SIZE[0])
            knuckle = (pad_x + side * 0.004, 0, 0.080)
            draw(body, "box", "steel", pos=knuckle, size=(0.006, 0.009, 0.016))
            body.add(
                "geom", name=name, type="box", pos=(pad_x, 0, GRIP_DEPTH), size=PAD_HALF_SIZE,
                mass=0, material="charcoal",
            )  # fmt: skip
        self.grip_site = mark(body, "grip", pos=(0, 0, GRIP_DEPTH))
