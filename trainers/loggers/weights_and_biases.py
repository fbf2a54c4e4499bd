"""Weights & Biases."""

from __future__ import annotations

import logging
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..storage.files import write_atomically
from ..storage.versions import versions
from .base import MetricsLogger, Rows, flatten
from .metrics import STEP_AXIS, Values

_log = logging.getLogger(__name__)


class WandbLogger(MetricsLogger):
    """A Weights & Biases run below ``wandb/``, offline unless asked otherwise.

    Every metric is drawn over ``env_steps``, in a section of the first part of its name. The configuration is stored
    with the versions of the packages under ``versions``. The run's id is kept in ``wandb_id``, so that a resumed run
    continues the same W&B run. ``wandb sync`` uploads an offline run later.

    Args:
        project: W&B project.
        online: send to the server while training; needs ``wandb login``.
        group: what the run is compared with, for instance the experiment.
        job_type: its part in the comparison, for instance the arm.
        tags: labels of the run.
        name: the run's display name; the name of its directory when left out.

    """

    CONNECT_SECONDS = 30.0
    FINISH_SECONDS = 120.0
    """How long the end waits for a server that does not answer; what is left stays on disk for ``wandb sync``."""

    def __init__(
        self,
        project: str = "rrl",
        online: bool = False,
        group: str | None = None,
        job_type: str | None = None,
        tags: Sequence[str] = (),
        name: str | None = None,
    ) -> None:
        self.project, self.online, self.name = project, online, name
        self.group, self.job_type, self.tags = group, job_type, list(tags)

    def start(
        self, run_dir: Path, config: Mapping[str, Any], seeds: Sequence[int], env_steps: int
    ) -> None:
        """Start or continue the W&B run."""
        import wandb

        self.seeds = seeds
        identity = run_dir / "wandb_id"
        if not identity.exists():
            write_atomically(identity, secrets.token_hex(4))
        arguments: dict[str, Any] = {
            "project": self.project,
            "group": self.group,
            "job_type": self.job_type,
            "tags": self.tags,
            "name": self.name or run_dir.name,
            "id": identity.read_text().strip(),
            "resume": "allow",
            "dir": str(run_dir),
            "config": {**config, "versions": versions()},
            "settings": wandb.Settings(
                silent=True,
                console="off",
                init_timeout=self.CONNECT_SECONDS,
                finish_timeout=self.FINISH_SECONDS,
            ),
        }
        try:
            self.run = wandb.init(mode="online" if self.online else "offline", **arguments)
        except Exception as error:
            if not self.online:
                raise
            _log.warning(
                "W&B cannot be reached (%s); logging offline, `wandb sync` uploads it later", error
            )
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

    def log_table(self, name: str, columns: Sequence[str], rows: Rows, env_steps: int) -> None:
        """Log a table."""
        import wandb

        table = wandb.Table(
            columns=list(columns), data=[list(row) for row in rows], allow_mixed_types=True
        )
        self.run.log({STEP_AXIS: env_steps, name: table})

    def finish(self) -> None:
        """Finish the run."""
        self.run.finish()
