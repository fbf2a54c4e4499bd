"""Faults of a sensor, such as the camera tracker's."""

from rrl.transforms.sensing.observation_dropout import ObservationDropout
from rrl.transforms.sensing.observation_latency import ObservationLatency
from rrl.transforms.sensing.observation_noise import ObservationNoise

__all__ = ["ObservationDropout", "ObservationLatency", "ObservationNoise"]
