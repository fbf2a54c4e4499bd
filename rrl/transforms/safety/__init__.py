"""Limits on what reaches the environment."""
