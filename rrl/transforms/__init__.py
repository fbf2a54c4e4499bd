"""Transforms for any TorchRL environment: residual action, disturbances, sensing faults."""

from rrl.transforms.control_noise import ControlNoise
from rrl.transforms.observation_latency import ObservationLatency
from rrl.transforms.observation_noise import ObservationNoise
from rrl.transforms.residual_action import ResidualAction

__all__ = ["ControlNoise", "ObservationLatency", "ObservationNoise", "ResidualAction"]
