"""Transforms for any TorchRL environment: residual, operator, disturbance, sensing, safety."""

from rrl.transforms.action_history import ActionHistory
from rrl.transforms.control_noise import ControlNoise
from rrl.transforms.episode_value import EpisodeValue
from rrl.transforms.intervention import Intervention
from rrl.transforms.judged_success import JudgedSuccess
from rrl.transforms.residual_action import ResidualAction
from rrl.transforms.safety import (
    FiniteAction,
    FiniteObservation,
    ForceLimit,
    SafetyLimit,
    StepLimit,
    WorkspaceLimit,
)
from rrl.transforms.sensing import ObservationDropout, ObservationLatency, ObservationNoise

__all__ = [
    "ActionHistory",
    "ControlNoise",
    "EpisodeValue",
    "FiniteAction",
    "FiniteObservation",
    "ForceLimit",
    "Intervention",
    "JudgedSuccess",
    "ObservationDropout",
    "ObservationLatency",
    "ObservationNoise",
    "ResidualAction",
    "SafetyLimit",
    "StepLimit",
    "WorkspaceLimit",
]
