"""Faults of sensing: noise, latency."""
