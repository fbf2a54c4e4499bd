"""What the task writes - observation, metrics, reward, success - as functions of measured arrays.

The composer task and the batched environment both call :func:`evaluate`, so that there is one
definition of the task. A new quantity is one entry of ``OBSERVATIONS``, ``METRICS`` or
``REWARD_TERMS``; what it reads of the simulation is a sensor of :mod:`.model.sensors`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from rrl import keys

from .config import InsertionConfig
from .physics.signals import Signals


class Measurement(NamedTuple):
    """What one control step shows of each of B environments; left block first. World frame, SI."""

    end_effector: np.ndarray
    """[B, 3] center of the tool from the arm's kinematics, m."""
    held_block: np.ndarray
    """[B, 3] middle of the held block, m."""
    block_position: np.ndarray
    """[B, 2, 3] middles of the standing blocks, m."""
    goal: np.ndarray
    """[B, 3] where the middle of the held block belongs: in the gap, m."""
    tilt: np.ndarray
    """[B, 2] theta: angle of toppling about the block's own long axis, positive towards +x, rad."""
    yaw: np.ndarray
    """[B, 2] phi: angle about the vertical, rad."""
    inclination: np.ndarray
    """[B, 2] angle between the block's upward axis and the vertical, in any direction, rad."""
    wrench: np.ndarray
    """[B, 6] mean over the control step of the force [N] and torque [N m] that the surroundings
    exert on the tool; its weight is tared."""
    signals: Signals
    """Every signal in every substep, [B, substeps, *shape]; see :mod:`.model.sensors`."""


Quantity = Callable[[Measurement, InsertionConfig], np.ndarray]


class Observation(NamedTuple):
    """One entry of the observation: its length, and the function that gives it, [B, size]."""

    size: int
    value: Quantity


class RewardTerm(NamedTuple):
    """One term of the reward, -weight * cost; a config's ``reward_weights`` replace the weight."""

    weight: float
    cost: Quantity


def measure(signals: Signals, tare: np.ndarray) -> Measurement:
    """Return the measurement at the end of a control step; arguments as in :func:`evaluate`."""
    upward = signals["block_z_axis"][:, -1]  # (B, 2, 3)
    along = signals["block_y_axis"][:, -1]  # (B, 2, 3)
    yaw = np.arctan2(-along[..., 0], along[..., 1])
    lean = upward[..., 0] * np.cos(yaw) + upward[..., 1] * np.sin(yaw)
    sideways = np.sqrt(upward[..., 0] ** 2 + upward[..., 1] ** 2)
    force = signals["wrist_force"].mean(axis=1)  # (B, 3)
    torque = signals["wrist_torque"].mean(axis=1)  # (B, 3)
    return Measurement(
        end_effector=signals["tool_position"][:, -1],
        held_block=signals["held_position"][:, -1],
        block_position=signals["block_position"][:, -1],
        goal=signals["goal_position"][:, -1],
        tilt=np.arctan2(lean, upward[..., 2]),
        yaw=yaw,
        inclination=np.arctan2(sideways, upward[..., 2]),
        wrench=tare - np.concatenate((force, torque), axis=-1),
        signals=signals,
    )


def _norm(vector: np.ndarray) -> np.ndarray:
    return np.sqrt((vector * vector).sum(axis=-1))


def _blocks(m: Measurement, config: InsertionConfig) -> np.ndarray:
    """Return position, tilt and yaw of each standing block, then the held block's position."""
    poses = np.concatenate((m.block_position, m.tilt[..., None], m.yaw[..., None]), axis=-1)
    return np.concatenate((poses.reshape(-1, 10), m.held_block), axis=-1)  # (B, 13)


def _distance(m: Measurement, config: InsertionConfig) -> np.ndarray:
    point = m.held_block if config.reward_point == "held_block" else m.end_effector
    return _norm(point - m.goal)


def _displacement(m: Measurement, config: InsertionConfig) -> np.ndarray:
    goals = config.block_goals + (m.goal - np.asarray(config.goal))[:, None]  # (B, 2, 3)
    return _norm((m.block_position - goals).reshape(-1, 6))


OBSERVATIONS = {
    "end_effector_position": Observation(3, lambda m, config: m.end_effector),
    "wrench": Observation(6, lambda m, config: m.wrench),
    "force_z": Observation(1, lambda m, config: m.wrench[:, 2:3]),
    "blocks": Observation(13, _blocks),
    "goal": Observation(3, lambda m, config: np.broadcast_to(config.goal, (len(m.wrench), 3))),
}
"""The paper's section IV; of ``wrench`` and ``force_z`` the one that the config names."""

METRICS: dict[str, Quantity] = {
    "contact_force": lambda m, config: m.signals["contact_force"][..., 0].max(axis=1),
    "tilt": lambda m, config: m.inclination.max(axis=-1),
}
"""What is reported beside reward and success, [B]; units and reductions stand in the YAML."""

REWARD_TERMS = {
    "distance": RewardTerm(1.0, _distance),
    "tilt": RewardTerm(0.1, lambda m, config: np.abs(m.tilt).sum(axis=-1)),
    "displacement": RewardTerm(0.0, _displacement),
    "yaw": RewardTerm(0.0, lambda m, config: np.abs(m.yaw).sum(axis=-1)),
}
"""r = -|x_g - x_t| - lambda sum|theta| - mu |X_g - X_t| - beta sum|phi| (the paper's equations 4
and 5); costs [B] in m and rad."""


def success(m: Measurement, config: InsertionConfig) -> np.ndarray:
    """Return whether the inserted block is at its goal with both standing blocks upright, [B]."""
    near = _norm(m.held_block - m.goal) < config.position_tolerance
    return near & (m.inclination.max(axis=-1) < config.tilt_tolerance)


def observation_sizes(config: InsertionConfig) -> dict[str, int]:
    """Return the observation's entries and their lengths."""
    absent = {"wrench", "force_z"} - {config.force_observation}
    return {name: entry.size for name, entry in OBSERVATIONS.items() if name not in absent}


def reward_weights(config: InsertionConfig) -> dict[str, float]:
    """Return the weights by the term's name; terms of weight zero are left out.

    Raises:
        ValueError: If the config names a term that does not exist, or leaves none.
    """
    unknown = sorted(set(config.reward_weights).difference(REWARD_TERMS))
    if unknown:
        raise ValueError(f"reward_weights: expected names of {list(REWARD_TERMS)}, got {unknown}")
    weights = {name: term.weight for name, term in REWARD_TERMS.items()} | config.reward_weights
    if not any(weights.values()):
        raise ValueError(f"reward_weights: expected one above 0 at least, got {weights}")
    return {name: weight for name, weight in weights.items() if weight}


def output_names(config: InsertionConfig) -> list[str]:
    """Return the names of what :func:`evaluate` gives, but for the reward."""
    metrics = [f"{keys.METRICS}/{name}" for name in METRICS]
    terms = [f"{keys.REWARD_TERMS}/{name}" for name in reward_weights(config)]
    return [*observation_sizes(config), keys.SUCCESS, *metrics, *terms]


def evaluate(signals: Signals, tare: np.ndarray, config: InsertionConfig) -> dict[str, np.ndarray]:
    """Return all that the task writes: arrays [B, n] by name, nested names as ``group/name``.

    Args:
        signals: Signals of every substep, [B, substeps, *shape].
        tare: Wrist reading of the unloaded tool at rest, [6] [N] and [N m].
        config: The task.
    """
    m = measure(signals, tare)
    terms = [
        -weight * REWARD_TERMS[name].cost(m, config)
        for name, weight in reward_weights(config).items()
    ]
    values = [
        *(OBSERVATIONS[name].value(m, config) for name in observation_sizes(config)),
        success(m, config),
        *(metric(m, config) for metric in METRICS.values()),
        *terms,
    ]
    out = dict(zip(output_names(config), values, strict=True))
    out[keys.REWARD] = np.sum(terms, axis=0)
    return {name: value if value.ndim == 2 else value[:, None] for name, value in out.items()}
