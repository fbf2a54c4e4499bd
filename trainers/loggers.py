"""Where metrics go: a tidy CSV file, TensorBoard, Weights & Biases. All write below the run's directory."""

from __future__ import annotations

import contextlib
import csv
import logging
import os
import secrets
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from .files import write_atomically
from .metrics import STEP_AXIS, Values

_log = logging.getLogger(__name__)


class MetricsLogger(ABC):
    """A sink for metrics and media.

    ``start`` is called once with the run's directory, its configuration and the environment step from which the run
    goes on (0 for a new run); after it ``log`` is called with increasing steps.
    """

    @abstractmethod
    def start(self, run_dir: Path, config: Mapping[str, Any], seeds: Sequence[int], env_steps: int) -> None:
        """Open the sink; forget what was logged after ``env_steps``."""

    @abstractmethod
    def log(self, values: Values, env_steps: int) -> None:
        """Record one value per seed for every metric."""

    def log_file(self, name: str, path: Path, env_steps: int) -> None:  # noqa: B027 - not every sink shows media
        """Record a picture (``.png``) or a video (``.mp4``, ``.gif``)."""

    def flush(self) -> None:  # noqa: B027 - not every sink holds anything back
        """Put on disk what was logged; called before every checkpoint."""

    def finish(self) -> None:  # noqa: B027 - not every sink needs closing
        """Flush and close."""


class Guarded(MetricsLogger):
    """A logger whose failure is said once and does not stop the run.

    Args:
        logger: the logger; left alone after its first error.
    """

    def __init__(self, logger: MetricsLogger) -> None:
        self.logger = logger
        self._state: str = "idle"

    def start(self, run_dir: Path, config: Mapping[str, Any], seeds: Sequence[int], env_steps: int) -> None:
        """Open the sink."""
        self._state = "running"
        self._try("start", run_dir, config, seeds, env_steps)

    def log(self, values: Values, env_steps: int) -> None:
        """Record metrics."""
        self._try("log", values, env_steps)

    def log_file(self, name: str, path: Path, env_steps: int) -> None:
        """Record a picture or a video."""
        self._try("log_file", name, path, env_steps)

    def flush(self) -> None:
        """Put on disk what was logged."""
        self._try("flush")

    def finish(self) -> None:
        """Close a sink that was opened; one that is broken may fail silently."""
        if self._state == "broken":
            with contextlib.suppress(Exception):
                self.logger.finish()
        self._try("finish")
        self._state = "idle"

    def _try(self, method: str, *arguments: Any) -> None:
        if self._state != "running":
            return
        try:
            getattr(self.logger, method)(*arguments)
        except Exception as error:  # whatever a sink or its network can come up with
            self._state = "broken"
            _log.warning(
                "%s failed (%s: %s); training goes on without it",
                type(self.logger).__name__,
                type(error).__name__,
                error,
            )


class CSVLogger(MetricsLogger):
    """``metrics.csv`` with columns ``env_steps, seed, metric, value``: the run's own record, read by the plots."""

    FILE = "metrics.csv"

    def start(self, run_dir: Path, config: Mapping[str, Any], seeds: Sequence[int], env_steps: int) -> None:
        """Open the file; a resumed run keeps the rows up to ``env_steps``."""
        path = run_dir / self.FILE
        self.seeds = seeds
        rows = _rows_until(path, env_steps) if env_steps else []
        partial = path.with_suffix(".partial")
        with partial.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([STEP_AXIS, "seed", "metric", "value"])
            writer.writerows(rows)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
        self.file: TextIO = path.open("a", newline="")
        self.writer = csv.writer(self.file)

    def log(self, values: Values, env_steps: int) -> None:
        """Append one row per seed and metric, and hand them to the operating system at once."""
        for metric, per_seed in values.items():
            for seed, value in zip(self.seeds, per_seed, strict=True):
                self.writer.writerow([env_steps, seed, metric, repr(float(value))])
        self.file.flush()

    def flush(self) -> None:
        """Have the disk hold all rows."""
        os.fsync(self.file.fileno())

    def finish(self) -> None:
        """Close the file."""
        self.file.close()


class TensorBoardLogger(MetricsLogger):
    """Event files under ``tensorboard/``: the mean over seeds, and each seed of a stack beside it."""

    def start(self, run_dir: Path, config: Mapping[str, Any], seeds: Sequence[int], env_steps: int) -> None:
        """Open the event file; TensorBoard drops what lies after ``env_steps``."""
        from torch.utils.tensorboard import SummaryWriter

        self.seeds = seeds
        self.writer = SummaryWriter(str(run_dir / "tensorboard"), purge_step=env_steps + 1 if env_steps else None)

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


class WandbLogger(MetricsLogger):
    """A Weights & Biases run below ``wandb/``, offline unless asked otherwise.

    Every metric is drawn over ``env_steps``. The run's id is kept in ``wandb_id``, so that a resumed run continues the
    same W&B run. ``wandb sync`` uploads an offline run later.

    Args:
        project: W&B project.
        online: send to the server while training; needs ``wandb login``.
        group: groups runs, for instance by experiment.
        tags: labels of the run.
        name: the run's display name; the name of its directory when left out.

    """

    CONNECT_SECONDS = 30.0

    def __init__(
        self,
        project: str = "rrl",
        online: bool = False,
        group: str | None = None,
        tags: Sequence[str] = (),
        name: str | None = None,
    ) -> None:
        self.project, self.online, self.group = project, online, group
        self.tags, self.name = list(tags), name

    def start(self, run_dir: Path, config: Mapping[str, Any], seeds: Sequence[int], env_steps: int) -> None:
        """Start or continue the W&B run."""
        import wandb

        self.seeds = seeds
        identity = run_dir / "wandb_id"
        if not identity.exists():
            write_atomically(identity, secrets.token_hex(4))
        arguments: dict[str, Any] = {
            "project": self.project,
            "group": self.group,
            "tags": self.tags,
            "name": self.name or run_dir.name,
            "id": identity.read_text().strip(),
            "resume": "allow",
            "dir": str(run_dir),
            "config": dict(config),
            "settings": wandb.Settings(silent=True, console="off", init_timeout=self.CONNECT_SECONDS),
        }
        try:
            self.run = wandb.init(mode="online" if self.online else "offline", **arguments)
        except Exception as error:
            if not self.online:
                raise
            _log.warning("W&B cannot be reached (%s); logging offline, `wandb sync` uploads it later", error)
            if wandb.run is None:
                wandb.teardown()  # the failed attempt holds on to the run's id
            self.run = wandb.init(mode="offline", **arguments)
        self.run.define_metric(STEP_AXIS)
        self.run.define_metric("*", step_metric=STEP_AXIS)

    def log(self, values: Values, env_steps: int) -> None:
        """Log one history row."""
        self.run.log({STEP_AXIS: env_steps, **flatten(values, self.seeds)})

    def log_file(self, name: str, path: Path, env_steps: int) -> None:
        """Log a picture or a video."""
        import wandb

        media = wandb.Image(str(path)) if path.suffix == ".png" else wandb.Video(str(path))
        self.run.log({STEP_AXIS: env_steps, name: media})

    def finish(self) -> None:
        """Finish the run."""
        self.run.finish()


def flatten(values: Values, seeds: Sequence[int]) -> dict[str, float]:
    """One scalar per metric: the mean over seeds; for a stack also ``<metric>/seed_<n>``."""
    out = {}
    for metric, per_seed in values.items():
        out[metric] = float(np.mean(per_seed))
        if len(seeds) > 1:
            out |= {f"{metric}/seed_{s}": float(v) for s, v in zip(seeds, per_seed, strict=True)}
    return out


def read_metrics(run_dir: Path) -> dict[str, dict[int, list[tuple[int, float]]]]:
    """Read a run's ``metrics.csv``: metric, then seed, then ``(env_steps, value)`` in order."""
    out: dict[str, dict[int, list[tuple[int, float]]]] = {}
    with (run_dir / CSVLogger.FILE).open(newline="") as file:
        for row in csv.DictReader(file):
            series = out.setdefault(row["metric"], {}).setdefault(int(row["seed"]), [])
            series.append((int(row[STEP_AXIS]), float(row["value"])))
    return out


def _rows_until(path: Path, env_steps: int) -> list[list[str]]:
    """Whole rows up to ``env_steps``; a row torn by a crash is dropped."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = [row for row in csv.reader(file) if len(row) == 4 and row[0].isdigit()]
    return [row for row in rows if int(row[0]) <= env_steps]
