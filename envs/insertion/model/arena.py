"""Platform, table, floor, light, cameras and the solver's settings."""

from __future__ import annotations

from typing import Any

from dm_control import composer

from ..config import InsertionConfig

TABLE_HEIGHT = 0.75
"""Of the platform's surface, z = 0, above the floor, m."""
CAMERAS = ("overview", "closeup", "front", "gap")


class PlatformArena(composer.Arena):
    """A table in front of the robot with a raised platform whose surface is the plane z = 0."""

    def _build(self, config: InsertionConfig, name: str = "insertion") -> None:
        super()._build(name)
        self.mjcf_model.option.set_attributes(
            timestep=config.physics_timestep, integrator="implicitfast", cone="elliptic",
            iterations=10, ls_iterations=20, noslip_iterations=0,
        )  # fmt: skip
        self.mjcf_model.option.flag.multiccd = "enable"
        self._add_look()
        # What the blocks touch is an unseen plane: box on plane is exact and cheap.
        self.mjcf_model.worldbody.add(
            "geom", name="surface", type="plane", size=(1, 1, 0.1), group=4,
            friction=(config.platform_friction, 0.005, 0.0001),
        )  # fmt: skip
        self._add_furniture(*config.goal_xy, config.base_height)
        self._add_cameras(*config.goal_xy)

    def _add_look(self) -> None:
        root = self.mjcf_model
        root.visual.headlight.set_attributes(
            ambient=(0.35, 0.35, 0.36), diffuse=(0.25, 0.25, 0.25), specular=(0.1, 0.1, 0.1)
        )
        root.visual.quality.shadowsize = 4096
        root.visual.map.set_attributes(znear=0.01, zfar=40, shadowclip=1.5)
        getattr(root.visual, "global").set_attributes(offwidth=1280, offheight=960)
        root.asset.add(
            "texture", name="sky", type="skybox", builtin="gradient",
            rgb1=(0.93, 0.95, 0.97), rgb2=(0.60, 0.68, 0.78), width=64, height=64,
        )  # fmt: skip
        root.asset.add(
            "texture", name="floor", type="2d", builtin="checker", width=100, height=100,
            rgb1=(0.74, 0.76, 0.79), rgb2=(0.69, 0.71, 0.75),
        )  # fmt: skip
        root.asset.add(
            "material", name="floor", texture="floor", texrepeat=(12, 12), reflectance=0.05
        )
        root.asset.add("material", name="table", rgba=(0.80, 0.71, 0.58, 1), specular=0.2)
        root.asset.add("material", name="platform", rgba=(0.25, 0.28, 0.33, 1), specular=0.3)
        root.asset.add("material", name="pedestal", rgba=(0.13, 0.135, 0.15, 1), specular=0.3)
        root.worldbody.add(
            "light", name="key", pos=(0.2, -1.4, 2.2), dir=(0.22, 0.55, -0.85), directional=True,
            diffuse=(0.62, 0.61, 0.58), specular=(0.35, 0.35, 0.35), castshadow=True,
        )  # fmt: skip
        root.worldbody.add(
            "light", name="fill", pos=(1.6, 1.2, 1.6), dir=(-0.6, -0.5, -0.6), directional=True,
            diffuse=(0.18, 0.2, 0.24), specular=(0.1, 0.1, 0.1), castshadow=False,
        )  # fmt: skip

    def _add_furniture(self, x: float, y: float, base_height: float) -> None:
        def decor(kind: str, material: str, **shape: Any) -> None:
            self.mjcf_model.worldbody.add(
                "geom", type=kind, material=material, contype=0, conaffinity=0, **shape
            )

        decor("box", "platform", pos=(x, y, -0.01), size=(0.16, 0.12, 0.01))
        decor("box", "table", pos=(x + 0.05, y, -0.04), size=(0.33, 0.45, 0.02))
        leg = TABLE_HEIGHT / 2 - 0.03
        for side_x in (-1, 1):
            for side_y in (-1, 1):
                foot = (x + 0.05 + side_x * 0.29, y + side_y * 0.41, -TABLE_HEIGHT / 2 - 0.03)
                decor("box", "pedestal", pos=foot, size=(0.02, 0.02, leg))
        column = (0, 0, -TABLE_HEIGHT, 0, 0, base_height - 0.02)
        decor("cylinder", "pedestal", fromto=column, size=(0.11,))
        decor("box", "pedestal", pos=(0, 0, -TABLE_HEIGHT + 0.03), size=(0.26, 0.26, 0.03))
        decor("plane", "floor", pos=(0, 0, -TABLE_HEIGHT), size=(6, 6, 0.1))

    def _add_cameras(self, x: float, y: float) -> None:
        world = self.mjcf_model.worldbody
        target = world.add("body", name="camera_target", pos=(x, y, 0.09))
        middle = world.add("body", name="arm_target", pos=(x - 0.24, y, 0.27))
        for name, position, aim, fovy in zip(
            CAMERAS,
            (
                (x + 0.50, y - 1.60, 0.62),
                (x + 0.16, y - 0.50, 0.26),
                (x + 0.75, y - 0.12, 0.30),
                (x, y - 0.27, 0.37),  # along the gap, from above: shows it and the blocks' yaws
            ),
            (middle, target, target, target),
            (40, 38, 38, 34),
            strict=True,
        ):
            world.add("camera", name=name, pos=position, mode="targetbody", target=aim, fovy=fovy)
