"""What packages of the gallery need to run beside current versions of the others, in one place."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

__all__ = ["patch_gymnasium_robotics", "patch_metaworld", "patch_robosuite"]

WELD = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 5.0)
"""What Meta-World writes to a weld constraint: anchor [m], relative pose, torque scale."""


def patch_metaworld() -> None:
    """Let Meta-World 3.0 and 3.1 write the data of their weld constraints.

    They assign 11 numbers to a row of ``eq_data``, which has 12 columns since MuJoCo 3.17.
    """
    from metaworld.sawyer_xyz_env import SawyerMocapBase

    def reset_mocap_welds(self: Any) -> None:
        welds = np.asarray(self.model.eq_type) == int(mujoco.mjtEq.mjEQ_WELD)
        self.model.eq_data[welds, : len(WELD)] = WELD

    SawyerMocapBase.reset_mocap_welds = reset_mocap_welds


def patch_gymnasium_robotics() -> None:
    """Let Gymnasium-Robotics 1.4 recognize joints; see :func:`_joint_types`."""
    from gymnasium_robotics.utils import mujoco_utils

    mujoco_utils.mujoco = _mujoco_with(mjtJoint=_joint_types())


def patch_robosuite() -> None:
    """Let robosuite 1.5 recognize joints (:func:`_joint_types`) and read the mass matrix.

    It calls ``mj_fullM(model, matrix, data.qM)``; in MuJoCo 3.17 that is
    ``mj_fullM(model, data, matrix)``, and there is no ``qM``.
    """
    from robosuite.controllers.parts import controller
    from robosuite.utils import binding_utils

    def full_mass_matrix(model: Any, matrix: Any, data: Any) -> None:
        mujoco.mj_fullM(model, data, matrix)

    binding_utils.mujoco = _mujoco_with(mjtJoint=_joint_types())
    binding_utils.MjData.qM = property(lambda self: self._data)
    controller.mujoco = _mujoco_with(mj_fullM=full_mass_matrix)


def _joint_types() -> SimpleNamespace:
    """Return MuJoCo's joint types as integers.

    Packages ask whether a type, a NumPy integer, is in a tuple of MuJoCo's enumeration. Its members
    are not equal to NumPy's integers in MuJoCo 3.17.
    """
    return SimpleNamespace(**{n: int(kind) for n, kind in mujoco.mjtJoint.__members__.items()})


def _mujoco_with(**other: Any) -> Any:
    """Return what a module of a package may use as ``mujoco``, some of it replaced."""
    return SimpleNamespace(**{**vars(mujoco), **other})
