"""From a normalized Cartesian action to actuator set points, once a control step, batch first.

Both controllers move the set point relative to the *measured* position of the end effector,
x_d = x + action_scale * action, so that the whole state of the control loop is in the observation:
a set point that integrates would be hidden, and would wind up while the tool presses on something.
"""

from __future__ import annotations

import numpy as np

from ..config import InsertionConfig
from .signals import Signals

TOOL_DOWN_AXES = np.array([(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)])
"""Rows: x, y and z axis of a tool that points straight down."""
IK_DAMPING = 1e-7 * np.eye(6)
"""d I, in units of Cartesian compliance (about 1e-3 m/N in translation), against singularities."""
MAX_ROTATION_ERROR = 0.2
"""Largest orientation error that the inverse kinematics looks at, rad."""
_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


def set_points(
    signals: Signals, action: np.ndarray, config: InsertionConfig, home: np.ndarray
) -> np.ndarray:
    """Return actuator controls [B, nu] for an action in [-1, 1].

    Args:
        signals: The arm as measured before the step, [B, *shape].
        action: Normalized displacement (x, y, z), [B, 3].
        config: The task.
        home: Posture towards which the redundant joint is pulled, [7] [rad].
    """
    displacement = config.action_scale * action
    if config.controller == "cartesian":
        controls = np.zeros((len(action), 6))
        controls[:, :3] = signals["tool_position"] + displacement - np.asarray(config.goal)
        return controls
    return signals["joint_position"] + joint_displacement(signals, displacement, config, home)


def jacobian(signals: Signals) -> np.ndarray:
    """Return the tool's geometric Jacobian [B, 6, 7]: translation, then rotation, by joint."""
    axes = signals["joint_axis"]  # (B, 7, 3)
    arms = signals["tool_position"][:, None] - signals["joint_origin"]  # (B, 7, 3)
    result = np.empty((len(axes), 6, axes.shape[1]))
    result[:, :3] = _cross(axes, arms).swapaxes(1, 2)
    result[:, 3:] = axes.swapaxes(1, 2)
    return result


def orientation_error(signals: Signals) -> np.ndarray:
    """Return the rotation vector [B, 3] that turns the tool down, rad for small errors."""
    return 0.5 * _cross(signals["tool_axes"], TOOL_DOWN_AXES).sum(axis=1)


def joint_displacement(
    signals: Signals, displacement: np.ndarray, config: InsertionConfig, home: np.ndarray
) -> np.ndarray:
    """Return joint steps [B, 7] rad that move the tool by ``displacement`` [B, 3] m.

    Differential inverse kinematics: among the joint steps with J dq = e, where e holds the
    displacement [m] and a share of the correction of the tool's orientation [rad], it takes the one
    nearest to a step dq_0 towards the home posture, measured by the energy that the joint springs K
    store: dq = dq_0 + K^-1 J' (J K^-1 J' + d I)^-1 (e - J dq_0).
    """
    jac = jacobian(signals)  # (B, 6, 7)
    error = np.empty((len(jac), 6))
    error[:, :3] = displacement
    turn = np.clip(orientation_error(signals), -MAX_ROTATION_ERROR, MAX_ROTATION_ERROR)
    error[:, 3:] = config.ik_rotation_gain * turn
    posture = config.ik_posture_gain * (home - signals["joint_position"])  # (B, 7)
    error -= (jac @ posture[..., None])[..., 0]
    weighted = jac / np.asarray(config.joint_stiffness)  # (B, 6, 7)
    gram = weighted @ jac.swapaxes(1, 2) + IK_DAMPING
    wrench = np.linalg.solve(gram, error[..., None])  # (B, 6, 1)
    return posture + (weighted.swapaxes(1, 2) @ wrench)[..., 0]


def check_action(action: np.ndarray, num_envs: int) -> np.ndarray:
    """Return ``action`` [num_envs, 3] clipped to [-1, 1].

    Raises:
        ValueError: If it has another shape, or is not finite (the message names the slots).
    """
    if action.shape != (num_envs, 3):
        raise ValueError(
            f"action: expected shape {(num_envs, 3)} (environments, x y z), got {action.shape}"
        )
    finite = np.isfinite(action).all(axis=-1)
    if not finite.all():
        slots = np.flatnonzero(~finite).tolist()
        raise ValueError(
            f"action: expected finite numbers, got {action[~finite].tolist()} in slot(s) {slots}; "
            "check the policy's or controller's output for NaN"
        )
    return np.clip(action, -1.0, 1.0)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product over the last axis; np.cross is much slower on small arrays."""
    return a[..., _NEXT] * b[..., _AFTER] - a[..., _AFTER] * b[..., _NEXT]
