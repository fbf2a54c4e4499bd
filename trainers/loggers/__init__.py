"""Where metrics go: CSV, TensorBoard, Weights & Biases, all below the run's directory."""

from .base import Guarded, MetricsLogger
from .csv_file import CSVLogger, read_metrics
from .tensorboard import TensorBoardLogger
from .weights_and_biases import WandbLogger

__all__ = [
    "CSVLogger",
    "Guarded",
    "MetricsLogger",
    "TensorBoardLogger",
    "WandbLogger",
    "read_metrics",
]
