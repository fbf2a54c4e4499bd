"""Training, evaluation, command line.

What a script needs can be imported from here; each name is loaded at its first use, so that the
command line's help does not wait for torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .environment import EnvironmentFactory, Input
    from .metric import Metric
    from .settings import (
        AcceptanceSettings,
        CheckpointSettings,
        EvaluationSettings,
        TrainerSettings,
    )
    from .training.trainer import Trainer

__all__ = [
    "AcceptanceSettings",
    "CheckpointSettings",
    "EnvironmentFactory",
    "EvaluationSettings",
    "Input",
    "Metric",
    "Trainer",
    "TrainerSettings",
]

_MODULES = {
    "AcceptanceSettings": ".settings",
    "CheckpointSettings": ".settings",
    "EnvironmentFactory": ".environment",
    "EvaluationSettings": ".settings",
    "Input": ".environment",
    "Metric": ".metric",
    "Trainer": ".training.trainer",
    "TrainerSettings": ".settings",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(
            f"module {__name__!r} has no attribute {name!r}; it has {sorted(_MODULES)}"
        )
    return getattr(import_module(_MODULES[name], __name__), name)
