"""Limits on what reaches the environment."""

from rrl.transforms.safety.base import SafetyLimit
from rrl.transforms.safety.finite_action import FiniteAction
from rrl.transforms.safety.finite_observation import FiniteObservation
from rrl.transforms.safety.force_limit import ForceLimit
from rrl.transforms.safety.step_limit import StepLimit
from rrl.transforms.safety.workspace_limit import WorkspaceLimit

__all__ = [
    "FiniteAction",
    "FiniteObservation",
    "ForceLimit",
    "SafetyLimit",
    "StepLimit",
    "WorkspaceLimit",
]
