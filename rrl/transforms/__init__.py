"""Transforms for any TorchRL environment: residual action, disturbances, sensing faults, memory, safety limits."""

from rrl.transforms.action_history import ActionHistory
from rrl.transforms.control_noise import ControlNoise
from rrl.transforms.force_limit import ForceLimit
from rrl.transforms.observation_latency import ObservationLatency
from rrl.transforms.observation_noise import ObservationNoise
from rrl.transforms.residual_action import ResidualAction
from rrl.transforms.step_limit import StepLimit
from rrl.transforms.workspace_limit import WorkspaceLimit

__all__ = [
    "ActionHistory",
    "ControlNoise",
    "ForceLimit",
    "ObservationLatency",
    "ObservationNoise",
    "ResidualAction",
    "StepLimit",
    "WorkspaceLimit",
]
