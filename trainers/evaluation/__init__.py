"""Frozen episodes, paired with the controller alone."""
