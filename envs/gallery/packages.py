"""The gallery's packages, with what each needs to run beside MuJoCo 3.17: all patches are here."""

from __future__ import annotations

import importlib
import logging
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

WELD = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 5.0)
"""What Meta-World writes to a weld constraint: anchor [m], relative pose, torque scale."""


def gymnasium() -> Any:
    """Import Gymnasium, which needs no patch."""
    return _imported("gymnasium")


def lunar_lander() -> Any:
    """Import Gymnasium's lunar lander, which needs no patch, but pygame even without pictures."""
    return _imported("gymnasium.envs.box2d.lunar_lander")


def metaworld() -> Any:
    """Import Meta-World 3.0 or 3.1.

    They assign 11 numbers to a row of ``eq_data``, which has 12 columns in MuJoCo 3.17.
    """
    package = _imported("metaworld")
    _imported("metaworld.policies")

    def reset_mocap_welds(self: Any) -> None:
        welds = np.asarray(self.model.eq_type) == int(mujoco.mjtEq.mjEQ_WELD)
        self.model.eq_data[welds, : len(WELD)] = WELD

    package.sawyer_xyz_env.SawyerMocapBase.reset_mocap_welds = reset_mocap_welds
    return package


def gymnasium_robotics() -> Any:
    """Import Gymnasium-Robotics 1.4, which has to recognize joints: see :func:`_joint_types`."""
    package = _imported("gymnasium_robotics")
    _imported("gymnasium_robotics.utils.mujoco_utils").mujoco = _mujoco(mjtJoint=_joint_types())
    gymnasium().register_envs(package)
    return package


def robosuite() -> Any:
    """Import robosuite 1.5, which has to recognize joints and to read the mass matrix.

    For the first see :func:`_joint_types`. It calls ``mj_fullM(model, matrix, data.qM)``; in MuJoCo
    3.17 that is ``mj_fullM(model, data, matrix)``, and there is no ``qM``.
    """
    logging.getLogger("robosuite_logs").disabled = True  # it announces what it loads and lacks
    package = _imported("robosuite")
    _imported("robosuite.wrappers")
    binding = _imported("robosuite.utils.binding_utils")
    binding.mujoco = _mujoco(mjtJoint=_joint_types())
    binding.MjData.qM = property(lambda self: self._data)

    def full_mass_matrix(model: Any, matrix: Any, data: Any) -> None:
        mujoco.mj_fullM(model, data, matrix)

    controller = _imported("robosuite.controllers.parts.controller")
    controller.mujoco = _mujoco(mj_fullM=full_mass_matrix)
    return package


def _imported(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"{name}: expected the gallery's packages ({error}): pip install -e '.[gallery]' in "
            "the clone"
        ) from error


def _joint_types() -> SimpleNamespace:
    """Return MuJoCo's joint types as integers.

    Packages ask whether a type, a NumPy integer, is in a tuple of MuJoCo's enumeration. Its members
    are not equal to NumPy's integers in MuJoCo 3.17.
    """
    return SimpleNamespace(**{n: int(kind) for n, kind in mujoco.mjtJoint.__members__.items()})


def _mujoco(**other: Any) -> SimpleNamespace:
    """Return what a module of a package may use as ``mujoco``, some of it replaced."""
    return SimpleNamespace(**{**vars(mujoco), **other})
