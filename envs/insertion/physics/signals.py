"""The one interface between physics and task: named arrays that are views into MuJoCo's sensordata."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import numpy as np

Signals = Mapping[str, np.ndarray]
"""Name to array, batch dimensions first; see :func:`add_sensors` for names, shapes and units."""


def add_sensors(root: Any, arm: Any, tool_site: Any, held: Any, blocks: list[Any]) -> None:
    """Adds a sensor for everything that the task measures.

    ======================  =========  ============================================================
    signal                  shape      meaning
    ======================  =========  ============================================================
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
    ======================  =========  ============================================================

    All in world coordinates.

    Args:
        root: MJCF root that gets the sensors.
        arm: :class:`~rrl.envs.sawyer.Sawyer`.
        tool_site: site at the tool's centre.
        held: :class:`~rrl.envs.blocks.HeldBlock`.
        blocks: bodies of the left and right standing block.
    """
    sensor = root.sensor

    def frame(kind: str, name: str, objects: list[Any], objtype: str) -> None:
        for index, item in enumerate(objects):
            sensor.add(kind, name=f"{name}.{index}", objtype=objtype, objname=item)

    for index, joint in enumerate(arm.joints):
        sensor.add("jointpos", name=f"joint_position.{index}", joint=joint)
    frame("framepos", "joint_origin", arm.links, "xbody")
    frame("framezaxis", "joint_axis", arm.links, "xbody")
    sensor.add("framepos", name="tool_position", objtype="site", objname=tool_site)
    for index, axis in enumerate("xyz"):
        sensor.add(f"frame{axis}axis", name=f"tool_axes.{index}", objtype="site", objname=tool_site)
    sensor.add("force", name="wrist_force", site=arm.wrist_site)
    sensor.add("torque", name="wrist_torque", site=arm.wrist_site)
    sensor.add("touch", name="contact_force", site=held.skin_site)
    sensor.add("framepos", name="held_position", objtype="xbody", objname=held.body)
    frame("framepos", "block_position", blocks, "xbody")
    frame("frameyaxis", "block_y_axis", blocks, "xbody")
    frame("framezaxis", "block_z_axis", blocks, "xbody")


class SignalLayout:
    """Where each signal lies in ``sensordata``.

    Args:
        model: compiled model with the sensors of :func:`add_sensors`.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self.places: dict[str, tuple[slice, tuple[int, ...]]] = {}
        for index in range(model.nsensor):
            name, _, item = model.sensor(index).name.partition(".")
            start, size = int(model.sensor_adr[index]), int(model.sensor_dim[index])
            shape: tuple[int, ...] = (size,)
            if item:
                shape = (int(item) + 1, size) if size > 1 else (int(item) + 1,)
            first = self.places[name][0].start if name in self.places else start
            self.places[name] = (slice(first, start + size), shape)
        self.size = int(model.nsensordata)

    def views(self, sensordata: np.ndarray) -> Signals:
        """Named views [..., *shape] into ``sensordata`` [..., size]; nothing is copied."""
        return SignalViews(self.places, sensordata)


class SignalViews(Mapping[str, np.ndarray]):
    """Views that are made when they are asked for: a control step looks at a few of them only."""

    def __init__(
        self, places: Mapping[str, tuple[slice, tuple[int, ...]]], sensordata: np.ndarray
    ) -> None:
        self._places = places
        self._sensordata = sensordata

    def __getitem__(self, name: str) -> np.ndarray:
        where, shape = self._places[name]
        view = self._sensordata[..., where]
        return view if len(shape) == 1 else view.reshape(*view.shape[:-1], *shape)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)
