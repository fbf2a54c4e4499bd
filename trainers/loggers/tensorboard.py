"""TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .base import MetricsLogger, flatten
from .metrics import Values


class TensorBoardLogger(MetricsLogger):
    """Event files under ``tensorboard/``: the mean over seeds, and each seed of a stack beside it."""

    def start(
        self, run_dir: Path, config: Mapping[str, Any], seeds: Sequence[int], env_steps: int
    ) -> None:
        """Open the event file; TensorBoard drops what lies after ``env_steps``."""
        from torch.utils.tensorboard import SummaryWriter

        self.seeds = seeds
        self.writer = SummaryWriter(
            str(run_dir / "tensorboard"), purge_step=env_steps + 1 if env_steps else None
        )

    def log(self, values: Values, env_steps: int) -> None:
        """Write scalars."""
        for metric, value in flatten(values, self.seeds).items():
            self.writer.add_scalar(metric, value, env_steps)

    def log_file(self, name: str, path: Path, env_steps: int) -> None:
        """Write a picture."""
        if path.suffix == ".png":
            import imageio.v3 as iio

            self.writer.add_image(name, np.asarray(iio.imread(path)), env_steps, dataformats="HWC")

    def flush(self) -> None:
        """Write what is queued."""
        self.writer.flush()

    def finish(self) -> None:
        """Flush and close."""
        self.writer.close()
