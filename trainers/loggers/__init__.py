"""Where metrics go: a tidy CSV file, TensorBoard, Weights & Biases. All write below the run's directory."""

from .base import Guarded, MetricsLogger, flatten
from .csv_file import CSVLogger, read_metrics
from .tensorboard import TensorBoardLogger
from .weights_and_biases import WandbLogger

__all__ = [
    "CSVLogger",
    "Guarded",
    "MetricsLogger",
    "TensorBoardLogger",
    "WandbLogger",
    "flatten",
    "read_metrics",
]
