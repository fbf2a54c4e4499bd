"""Observation, reward and success as pure functions of measured arrays, batch first.

The composer task and the batched environment call these same functions, so that there is one
definition of the task.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .config import InsertionConfig
from .physics.signals import Signals


class Measurement(NamedTuple):
    """What one control step shows of each of B environments; left block first. World frame, SI."""

    end_effector: np.ndarray
    """[B, 3] centre of the tool from the arm's kinematics, m."""
    held_block: np.ndarray
    """[B, 3] middle of the held block, m."""
    block_position: np.ndarray
    """[B, 2, 3] middles of the standing blocks, m."""
    tilt: np.ndarray
    """[B, 2] theta: angle of toppling about the block's own long axis, positive towards +x, rad."""
    yaw: np.ndarray
    """[B, 2] phi: angle about the vertical, rad."""
    inclination: np.ndarray
    """[B, 2] angle between the block's upward axis and the vertical, in any direction, rad."""
    wrench: np.ndarray
    """[B, 6] mean over the control step of the force [N] and torque [N m] that the surroundings
    exert on the tool; its weight is tared."""
    contact_force: np.ndarray
    """[B] largest sum of normal forces on the held block within the control step, N."""


def measure(trace: Signals, tare: np.ndarray) -> Measurement:
    """Measurement at the end of a control step.

    Args:
        trace: signals of every substep, [B, substeps, *shape].
        tare: [6] wrist reading of the unloaded tool at rest, N and N m.
    """
    upward = trace["block_z_axis"][:, -1]  # (B, 2, 3)
    along = trace["block_y_axis"][:, -1]  # (B, 2, 3)
    yaw = np.arctan2(-along[..., 0], along[..., 1])
    lean = upward[..., 0] * np.cos(yaw) + upward[..., 1] * np.sin(yaw)
    sideways = np.sqrt(upward[..., 0] ** 2 + upward[..., 1] ** 2)
    force = trace["wrist_force"].mean(axis=1)  # (B, 3)
    torque = trace["wrist_torque"].mean(axis=1)  # (B, 3)
    return Measurement(
        end_effector=trace["tool_position"][:, -1].copy(),
        held_block=trace["held_position"][:, -1].copy(),
        block_position=trace["block_position"][:, -1].copy(),
        tilt=np.arctan2(lean, upward[..., 2]),
        yaw=yaw,
        inclination=np.arctan2(sideways, upward[..., 2]),
        wrench=tare - np.concatenate((force, torque), axis=-1),
        contact_force=trace["contact_force"][..., 0].max(axis=1),
    )


def desired_block_positions(config: InsertionConfig) -> np.ndarray:
    """X_g: where the left and right standing block belong, [2, 3] m."""
    x, y = config.goal_xy
    height = config.standing_half_size[2]
    return np.array([(x - config.block_offset, y, height), (x + config.block_offset, y, height)])


def observation(m: Measurement, config: InsertionConfig) -> dict[str, np.ndarray]:
    """The observation of the paper's section IV, one array [B, n] a key.

    ``blocks`` [13]: for each standing block position, tilt and yaw, then the held block's position.
    """
    batch = len(m.end_effector)
    blocks = np.empty((batch, 13))
    poses = blocks[:, :10].reshape(batch, 2, 5)
    poses[..., :3] = m.block_position
    poses[..., 3] = m.tilt
    poses[..., 4] = m.yaw
    blocks[:, 10:] = m.held_block
    values = {"end_effector_position": m.end_effector}
    if config.force_observation == "wrench":
        values["wrench"] = m.wrench
    else:
        values["force_z"] = m.wrench[:, 2:3]
    values["blocks"] = blocks
    values["goal"] = np.broadcast_to(np.asarray(config.goal), (batch, 3))
    return values


def observation_sizes(config: InsertionConfig) -> dict[str, int]:
    """Keys of the observation and their lengths."""
    force = {"wrench": 6} if config.force_observation == "wrench" else {"force_z": 1}
    return {"end_effector_position": 3, **force, "blocks": 13, "goal": 3}


def reward_terms(m: Measurement, config: InsertionConfig) -> dict[str, np.ndarray]:
    """Weighted terms [B] whose sum is the reward (equations 4 and 5 of the paper).

    r = -|x_g - x_t| - lambda sum|theta| - mu |X_g - X_t| - beta sum|phi|; terms of
    weight zero are left out.
    """
    point = m.held_block if config.reward_point == "held_block" else m.end_effector
    terms = {"distance": -_norm(point - np.asarray(config.goal))}
    if config.tilt_weight:
        terms["tilt"] = -config.tilt_weight * np.abs(m.tilt).sum(axis=-1)
    if config.displacement_weight:
        offset = m.block_position - desired_block_positions(config)  # (B, 2, 3)
        terms["displacement"] = -config.displacement_weight * _norm(offset.reshape(len(offset), 6))
    if config.yaw_weight:
        terms["yaw"] = -config.yaw_weight * np.abs(m.yaw).sum(axis=-1)
    return terms


def total(terms: dict[str, np.ndarray]) -> np.ndarray:
    """The reward [B]: sum of its terms."""
    return np.sum(list(terms.values()), axis=0)


def reward_term_names(config: InsertionConfig) -> tuple[str, ...]:
    """Names of the terms that :func:`reward_terms` gives."""
    weights = {
        "tilt": config.tilt_weight,
        "displacement": config.displacement_weight,
        "yaw": config.yaw_weight,
    }
    return ("distance", *(name for name, weight in weights.items() if weight))


def success(m: Measurement, config: InsertionConfig) -> np.ndarray:
    """[B] bool: the inserted block is at its goal and both standing blocks are upright."""
    near = _norm(m.held_block - np.asarray(config.goal)) < config.position_tolerance
    return near & (m.inclination.max(axis=-1) < config.tilt_tolerance)


def _norm(vector: np.ndarray) -> np.ndarray:
    return np.sqrt((vector * vector).sum(axis=-1))
