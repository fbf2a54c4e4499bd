"""Reinforcement learning algorithms on stacked seeds."""

from rrl.algorithms.base import Agent
from rrl.algorithms.ddpg import DDPG
from rrl.algorithms.sac import SAC
from rrl.algorithms.td3 import TD3

__all__ = ["DDPG", "SAC", "TD3", "Agent"]
