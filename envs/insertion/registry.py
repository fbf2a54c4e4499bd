"""Names of the composer environments."""

from __future__ import annotations

from typing import Any

import numpy as np

from .composer_env import InsertionEnvironment
from .composer_task import InsertionTask
from .config import PRESETS, make_config

_PREFIX = "insertion-"
NAMES = tuple(_PREFIX + variant for variant in PRESETS)
"""What :func:`load` takes."""


def load(
    name: str, random_state: int | np.random.RandomState | None = None, **overrides: Any
) -> InsertionEnvironment:
    """Makes a composer environment.

    Args:
        name: one of :data:`NAMES`.
        random_state: seed or generator of the resets.
        overrides: fields of :class:`~rrl.envs.InsertionConfig` to replace.

    Raises:
        ValueError: unknown name or setting; the message lists the choices.
    """
    if name not in NAMES:
        raise ValueError(f"unknown environment {name!r}; choose one of {list(NAMES)}")
    config = make_config(name.removeprefix(_PREFIX), overrides)
    return InsertionEnvironment(InsertionTask(config), random_state=random_state)
