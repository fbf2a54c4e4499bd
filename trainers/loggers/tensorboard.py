"""TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .base import MetricsLogger
from .metrics import Values


class TensorBoardLogger(MetricsLogger):
    """Event files under ``tensorboard/``."""

    def start(self, run_dir: Path, config: Mapping[str, Any], env_steps: int) -> None:
        """Open the event file; TensorBoard drops what lies after ``env_steps``; at 0, all of it."""
        from torch.utils.tensorboard import SummaryWriter

        purge = env_steps + 1 if env_steps else 0
        self.writer = SummaryWriter(str(run_dir / "tensorboard"), purge_step=purge)

    def log(self, values: Values, env_steps: int) -> None:
        """Write scalars."""
        for metric, value in values.items():
            self.writer.add_scalar(metric, value, env_steps)

    def log_file(self, name: str, path: Path, env_steps: int) -> None:
        """Write a picture; TensorBoard shows no videos."""
        if path.suffix == ".png":
            import imageio.v3 as iio

            self.writer.add_image(name, iio.imread(path), env_steps, dataformats="HWC")

    def flush(self) -> None:
        """Write what is queued."""
        self.writer.flush()

    def finish(self) -> None:
        """Flush and close."""
        self.writer.close()
