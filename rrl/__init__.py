"""Residual reinforcement learning for robot control, on TorchRL."""
