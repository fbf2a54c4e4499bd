"""A sensor for everything that the task measures."""

from __future__ import annotations

from typing import Any

from .blocks import HeldBlock
from .sawyer import Sawyer


def add_sensors(root: Any, arm: Sawyer, held: HeldBlock, blocks: list[Any], gap: Any) -> None:
    """Add the task's sensors; numbered ones (``name.index``) become one signal.

    ======================  =========  =========================================================
    signal                  shape      meaning
    ======================  =========  =========================================================
    ``joint_position``      [7]        rad
    ``joint_origin``        [7, 3]     anchors of the arm's joints, m
    ``joint_axis``          [7, 3]     their axes, unit vectors
    ``tool_position``       [3]        middle of the held block, from the arm's kinematics, m
    ``tool_axes``           [3, 3]     x, y and z axis of the tool, one a row
    ``wrist_force``         [3]        by the gripper's side on the wrist, aligned with the world
    ``wrist_torque``        [3]        while the tool points down, N and N m
    ``contact_force``       [1]        sum of normal contact forces on the held block, N
    ``held_position``       [3]        middle of the held block, m
    ``block_position``      [2, 3]     middles of the left and right standing block, m
    ``block_y_axis``        [2, 3]     long axis of the standing blocks
    ``block_z_axis``        [2, 3]     their upward axis
    ``goal_position``       [3]        where the middle of the held block belongs, m
    ======================  =========  =========================================================

    All in world coordinates.

    Args:
        root: MJCF root that gets the sensors.
        arm: The arm.
        held: The block in the hand; its center is the tool's.
        blocks: MJCF bodies of the left and right standing block.
        gap: Site in the middle of the gap between them.
    """
    sensor = root.sensor

    def frame(kind: str, name: str, objects: list[Any]) -> None:
        for index, item in enumerate(objects):
            sensor.add(kind, name=f"{name}.{index}", objtype="xbody", objname=item)

    tool = {"objtype": "site", "objname": held.center_site}
    for index, joint in enumerate(arm.joints):
        sensor.add("jointpos", name=f"joint_position.{index}", joint=joint)
    frame("framepos", "joint_origin", arm.links)
    frame("framezaxis", "joint_axis", arm.links)
    sensor.add("framepos", name="tool_position", **tool)
    for index, axis in enumerate("xyz"):
        sensor.add(f"frame{axis}axis", name=f"tool_axes.{index}", **tool)
    sensor.add("force", name="wrist_force", site=arm.wrist_site)
    sensor.add("torque", name="wrist_torque", site=arm.wrist_site)
    sensor.add("touch", name="contact_force", site=held.skin_site)
    sensor.add("framepos", name="held_position", objtype="xbody", objname=held.body)
    frame("framepos", "block_position", blocks)
    frame("frameyaxis", "block_y_axis", blocks)
    frame("framezaxis", "block_z_axis", blocks)
    sensor.add("framepos", name="goal_position", objtype="site", objname=gap)
