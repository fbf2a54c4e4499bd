"""TorchRL's collector, without what TorchRL says of parts of its own while it is imported."""

import warnings

import torchrl  # noqa: F401 - first: its own filters come before those that are there

with warnings.catch_warnings():
    warnings.filterwarnings(
        "ignore", "Creating .* inherits from WeightUpdaterBase", DeprecationWarning
    )
    from torchrl.collectors import Collector

__all__ = ["Collector"]
