"""The commands of ``rrl``; the only place that knows Hydra."""
