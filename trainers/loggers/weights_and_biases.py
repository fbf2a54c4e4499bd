"""Weights & Biases."""

from __future__ import annotations

import logging
import os
import re
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..storage.files import write_atomically
from ..storage.versions import versions
from .base import MetricsLogger, Rows
from .metrics import STEP_AXIS, Values

_log = logging.getLogger(__name__)

_IGNORED = ("DIR", "JOB_TYPE", "NAME", "PROJECT", "RUN_GROUP", "RUN_ID", "TAGS")
"""W&B's environment variables that the configuration stands above."""


class WandbLogger(MetricsLogger):
    """A Weights & Biases run below ``wandb/``, offline unless asked otherwise.

    Every metric is drawn over ``env_steps``, in a section of the first part of its name. The
    configuration is stored with the package versions under ``versions``. The run's id is kept in
    ``wandb_id``, so that a resumed run continues the same W&B run. ``wandb sync`` uploads an
    offline run later. What it has of steps after the checkpoint that is resumed stays there, and
    these steps are logged once more. W&B's own ``WANDB_MODE`` and ``WANDB_DISABLED`` stand above
    ``online``.

    Args:
        project: W&B project.
        online: Send to the server while training; needs ``wandb login``.
        group: What the run is compared with, for instance the experiment. None: the directory of
            the runs that differ by the seed alone.
        job_type: Its part in the comparison, for instance the arm.
        tags: Labels of the run.
        name: The run's display name. None: the name of its directory.

    Raises:
        ValueError: If ``online`` or ``tags`` is text, which would be true, or a tag a letter.
    """

    CONNECT_SECONDS = 30.0
    FINISH_SECONDS = 120.0
    """How long the end waits for a server that does not answer; the rest stays on disk."""

    def __init__(
        self,
        project: str = "rrl",
        online: bool = False,
        group: str | None = None,
        job_type: str | None = None,
        tags: Sequence[str] = (),
        name: str | None = None,
    ) -> None:
        if not isinstance(online, bool):
            raise ValueError(f"online: expected true or false, got {online!r}")
        if isinstance(tags, str):
            raise ValueError(f"tags: expected a list, such as [{tags}], got {tags!r}")
        self.project, self.online, self.name = project, online, name
        self.group, self.job_type, self.tags = group, job_type, list(tags)

    def start(self, run_dir: Path, config: Mapping[str, Any], env_steps: int) -> None:
        """Start or continue the W&B run; nothing that it has is forgotten."""
        import wandb

        identity = run_dir / "wandb_id"
        if not identity.exists():
            write_atomically(identity, secrets.token_hex(4))
        group, name = self._names(run_dir)
        arguments: dict[str, Any] = {
            "project": self.project,
            "group": self.group or group,
            "job_type": self.job_type,
            "tags": self.tags,
            "name": name,
            "id": identity.read_text(encoding="utf-8").strip(),
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
        mode = self._mode()
        try:
            self.run = wandb.init(mode=mode, **arguments)
        except Exception as error:
            if mode != "online":
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
        self.run.log({STEP_AXIS: env_steps, **values})

    def log_file(self, name: str, path: Path, env_steps: int) -> None:
        """Log a picture or a video."""
        import wandb

        media = wandb.Image(str(path)) if path.suffix == ".png" else wandb.Video(str(path))
        self.run.log({STEP_AXIS: env_steps, name: media})

    def log_table(self, name: str, columns: Sequence[str], rows: Rows, env_steps: int) -> None:
        """Log a table."""
        import wandb

        data = [list(row) for row in rows]
        table = wandb.Table(columns=list(columns), data=data, allow_mixed_types=True)
        self.run.log({STEP_AXIS: env_steps, name: table})

    def finish(self) -> None:
        """Finish the run."""
        self.run.finish()

    def _mode(self) -> Any:
        """Choose W&B's mode, and say what its environment variables change or do not change."""
        mode = "online" if self.online else "offline"
        asked = os.environ.get("WANDB_MODE", "").lower()
        if os.environ.get("WANDB_DISABLED", "").lower() in ("1", "true", "yes", "on"):
            asked = "disabled"
        asked = {"dryrun": "offline", "run": "online"}.get(asked, asked)
        if asked and asked != mode:
            _log.warning(
                "W&B: the environment asks for %s, which stands above logger.wandb.online=%s",
                asked,
                str(self.online).lower(),
            )
        if ignored := [f"WANDB_{n}" for n in _IGNORED if os.environ.get(f"WANDB_{n}")]:
            _log.warning("W&B: %s not used: set logger.wandb instead", ", ".join(ignored))
        return asked or mode

    def _names(self, run_dir: Path) -> tuple[str, str]:
        """Return group and name by the directory, ``<group>/seed-3`` or a run by itself."""
        if re.fullmatch(r"seed-\d+", run_dir.name):
            group = run_dir.resolve().parent.name
            return group, f"{self.name or group} {run_dir.name}"
        return run_dir.name, self.name or run_dir.name
