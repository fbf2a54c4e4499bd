"""Gymnasium: landing with the heuristic that it ships, a double pendulum under an LQR."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.linalg import solve_discrete_are

from . import packages

Vector = NDArray[np.floating]


def lander_poses(env: Any) -> Vector:
    """Return where the lander and its legs are ``[3, 3]``: x, y and angle in Box2D's units."""
    lander = env.unwrapped
    bodies = (lander.lander, *lander.legs)
    return np.array([(*body.position, body.angle) for body in bodies])


def render_lander(
    env: Any, poses: Iterable[Vector], width: int = 640, height: int = 480
) -> NDArray[np.uint8]:
    """Return frames ``[T, height, width, 3]`` of what :func:`lander_poses` gave."""
    lander, frames = env.unwrapped, []
    lander.render_mode, lander.particles = "rgb_array", []
    for pose in poses:
        for body, (x, y, angle) in zip((lander.lander, *lander.legs), pose, strict=True):
            body.position, body.angle = (x, y), angle
        frames.append(Image.fromarray(lander.render()).resize((width, height)))
    return np.stack([np.asarray(frame) for frame in frames])


class LanderHeuristic:
    """The heuristic that Gymnasium ships for ``LunarLanderContinuous-v3``, as it is or made worse.

    Args:
        bias: Added to the action ``[2]``, within [-1, 1]: main engine, side engines.
    """

    def __init__(self, bias: Sequence[float] = (0.0, 0.0)) -> None:
        self.heuristic = packages.lunar_lander().heuristic
        self.bias = np.array(bias)
        self.lander = SimpleNamespace(unwrapped=SimpleNamespace(continuous=True))

    def __call__(self, observation: Vector) -> Vector:
        """Return the engines' commands ``[2]`` for an observation ``[8]``."""
        action = np.clip(self.heuristic(self.lander, observation), -1.0, 1.0)
        return np.clip(action + self.bias, -1.0, 1.0)


class DoublePendulumLQR:
    """Linear quadratic regulator of ``InvertedDoublePendulum-v5``, made for a wrong gravity.

    Args:
        gravity: Share of the true gravity that it is made for.
    """

    def __init__(self, gravity: float = 1.0) -> None:
        env = packages.gymnasium().make("InvertedDoublePendulum-v5").unwrapped
        model = copy.deepcopy(env.model)
        model.opt.gravity[:] *= gravity
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER  # RK4 has no derivatives
        a, b = _linearized(model, env.frame_skip)
        env.close()
        cost = np.diag([1.0, 10.0, 10.0, 0.1, 0.1, 0.1])
        p = solve_discrete_are(a, b, cost, np.eye(1))
        self.gain = np.linalg.solve(np.eye(1) + b.T @ p @ b, b.T @ p @ a)  # (1, 6)

    def __call__(self, observation: Vector) -> Vector:
        """Return the cart's command ``[1]``, within its bounds, for an observation ``[9]``."""
        angles = np.arctan2(observation[1:3], observation[3:5])
        state = np.concatenate([observation[:1], angles, observation[5:8]])
        return np.clip(-self.gain @ state, -1.0, 1.0)


def _linearized(model: mujoco.MjModel, frame_skip: int) -> tuple[Vector, Vector]:
    """Return how a small state [x, angles, velocities] and a small command go on in one step."""
    data, size = mujoco.MjData(model), 2 * model.nv
    a, b = np.zeros((size, size)), np.zeros((size, model.nu))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, a, b, None, None)
    total_a, total_b = np.eye(size), np.zeros_like(b)
    for _ in range(frame_skip):
        total_a, total_b = a @ total_a, a @ total_b + b
    return total_a, total_b
