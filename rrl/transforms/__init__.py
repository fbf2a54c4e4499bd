"""Transforms for any TorchRL environment: residual action, disturbances, sensing faults, memory, safety limits."""

from rrl.transforms.action_history import ActionHistory
from rrl.transforms.control_noise import ControlNoise
from rrl.transforms.residual_action import ResidualAction
from rrl.transforms.safety.force_limit import ForceLimit
from rrl.transforms.safety.step_limit import StepLimit
from rrl.transforms.safety.workspace_limit import WorkspaceLimit
from rrl.transforms.sensing.observation_latency import ObservationLatency
from rrl.transforms.sensing.observation_noise import ObservationNoise

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
