"""Reinforcement learning algorithms on stacked seeds."""

from rrl.algorithms.td3 import TD3

__all__ = ["TD3"]
