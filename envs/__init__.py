"""The block-insertion task of the paper: composer task, batched TorchRL environment, rendering.

Example:
    >>> from rrl.envs import InsertionEnv
    >>> env = InsertionEnv("real", num_envs=4, seed=0)
    >>> rollout = env.rollout(50)
"""

from __future__ import annotations

from .opengl import RenderingUnavailable  # isort: skip - it has to import MuJoCo first
from .composer import ComposerEnv
from .gymnasium import gymnasium_env
from .insertion.batched_env import InsertionEnv
from .insertion.composer_task import NAMES, InsertionTask, load
from .insertion.config import InsertionConfig, make_config
from .insertion.pixels_env import InsertionPixelsEnv
from .insertion.press_and_drag import PressAndDrag
from .insertion.render import render_composer, render_states
from .pictures import mujoco_state, render_mujoco
from .robot import RobotEnv

__all__ = [
    "NAMES",
    "ComposerEnv",
    "InsertionConfig",
    "InsertionEnv",
    "InsertionPixelsEnv",
    "InsertionTask",
    "PressAndDrag",
    "RenderingUnavailable",
    "RobotEnv",
    "gymnasium_env",
    "load",
    "make_config",
    "mujoco_state",
    "render_composer",
    "render_mujoco",
    "render_states",
]
