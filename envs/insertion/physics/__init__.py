"""Resets, control and rollouts of many environments in C."""
