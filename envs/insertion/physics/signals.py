"""The interface between physics and task: named arrays that are views into MuJoCo's sensordata."""

from __future__ import annotations

import mujoco
import numpy as np

Signals = dict[str, np.ndarray]
"""Arrays by name, batch dimensions first; :mod:`..model.sensors` has names, shapes and units."""


class SignalLayout:
    """Where each signal lies in ``sensordata``.

    Args:
        model: Compiled model with the sensors of :func:`..model.sensors.add_sensors`.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._places: dict[str, tuple[slice, tuple[int, ...]]] = {}
        for index in range(model.nsensor):
            name, _, item = model.sensor(index).name.partition(".")
            start, size = int(model.sensor_adr[index]), int(model.sensor_dim[index])
            shape: tuple[int, ...] = (size,)
            if item:
                shape = (int(item) + 1, size) if size > 1 else (int(item) + 1,)
            first = self._places[name][0].start if name in self._places else start
            self._places[name] = (slice(first, start + size), shape)
        self.size = int(model.nsensordata)

    def views(self, sensordata: np.ndarray) -> Signals:
        """Return named views [..., *shape] into ``sensordata`` [..., size]; nothing is copied."""
        batch = sensordata.shape[:-1]
        return {
            name: sensordata[..., where].reshape(*batch, *shape)
            for name, (where, shape) in self._places.items()
        }
