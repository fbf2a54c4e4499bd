"""Residual reinforcement learning for robot control, on TorchRL.

The public names can be imported from here. Each is loaded at its first use, so that ``import rrl``
and the command line's help do not wait for torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rrl.algorithms import *
    from rrl.controllers import *
    from rrl.encoders import *
    from rrl.interventions import *
    from rrl.transforms import *

__all__ = [
    "DDPG",
    "SAC",
    "TD3",
    "ActionHistory",
    "Adam",
    "Agent",
    "AgentSettings",
    "Concatenate",
    "ControlNoise",
    "Controller",
    "EnsembleSACLoss",
    "EnsembleTD3Loss",
    "EnvironmentFactory",
    "EpisodeValue",
    "FiniteAction",
    "FiniteObservation",
    "ForceLimit",
    "FrozenEncoder",
    "FunctionController",
    "Intervention",
    "InterventionSampler",
    "JudgedSuccess",
    "Multiplier",
    "ObservationDropout",
    "ObservationLatency",
    "ObservationNoise",
    "PIDController",
    "PixelEncoder",
    "PolicyController",
    "ProportionalController",
    "ReplayController",
    "ResidualAction",
    "SafetyLimit",
    "ScriptedOperator",
    "StatefulController",
    "StepLimit",
    "SumController",
    "TorchOptimizer",
    "Trainer",
    "TrainerSettings",
    "WorkspaceLimit",
    "ZeroController",
    "automatic",
    "mlp",
    "no_exploration",
    "random_shift",
    "relabel_interventions",
]

_TRAINERS = ("EnvironmentFactory", "Trainer", "TrainerSettings")
_PACKAGES = (
    "rrl.controllers",
    "rrl.encoders",
    "rrl.transforms",
    "rrl.algorithms",
    "rrl.interventions",
)


def __getattr__(name: str) -> Any:
    if name in __all__:
        packages = ("rrl.trainers",) if name in _TRAINERS else _PACKAGES
        for package in map(import_module, packages):
            if name in package.__all__:
                return globals().setdefault(name, getattr(package, name))
    raise AttributeError(f"rrl: expected one of {', '.join(__all__)}, got {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
