"""Learners from TorchRL's losses, and what they are configured with."""

from rrl.algorithms.base import Agent
from rrl.algorithms.ddpg import DDPG
from rrl.algorithms.ensemble import EnsembleSACLoss, EnsembleTD3Loss
from rrl.algorithms.multiplier import Multiplier
from rrl.algorithms.networks import mlp
from rrl.algorithms.optimizers import Adam, TorchOptimizer
from rrl.algorithms.sac import SAC, no_exploration
from rrl.algorithms.settings import AgentSettings
from rrl.algorithms.td3 import TD3

__all__ = [
    "DDPG",
    "SAC",
    "TD3",
    "Adam",
    "Agent",
    "AgentSettings",
    "EnsembleSACLoss",
    "EnsembleTD3Loss",
    "Multiplier",
    "TorchOptimizer",
    "mlp",
    "no_exploration",
]
