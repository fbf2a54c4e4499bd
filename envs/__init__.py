"""The block-insertion task of the paper: composer task, batched TorchRL environment, rendering.

Example:
    >>> from rrl.envs import InsertionEnv
    >>> env = InsertionEnv("real", num_envs=4, seed=0)
    >>> rollout = env.rollout(50)
"""

from __future__ import annotations

from . import _quiet as _quiet  # before anything that imports dm_control
from .composer_env import ComposerEnv
from .config import InsertionConfig, make_config
from .insertion import InsertionEnv
from .registry import NAMES, load
from .render import Renderer, RenderingUnavailable, render_composer, render_states, write_video
from .task import InsertionTask

__all__ = [
    "NAMES",
    "ComposerEnv",
    "InsertionConfig",
    "InsertionEnv",
    "InsertionTask",
    "Renderer",
    "RenderingUnavailable",
    "load",
    "make_config",
    "render_composer",
    "render_states",
    "write_video",
]
