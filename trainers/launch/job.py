"""A job of the pool: one run of one seed, in a directory of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from ..storage.files import write_atomically
from ..storage.run_files import CONFIG_FILE, LOG, RESULTS
from ..storage.same_run import measured_settings


@dataclass(frozen=True)
class Job:
    """One run: an ordinary directory of `rrl train`, made by ``rrl train resume=PATH``.

    Attributes:
        path: The run's directory.
        config: Its resolved configuration, of one seed.
        needs: Directories of runs that must be finished before.
    """

    path: Path
    config: Mapping[str, Any] = field(repr=False, compare=False)
    needs: tuple[Path, ...] = ()

    @property
    def name(self) -> str:
        """The last two parts of the path."""
        return f"{self.path.parent.name}/{self.path.name}"

    @property
    def log(self) -> Path:
        """What the run's process prints."""
        return self.path / LOG

    @property
    def total_steps(self) -> int:
        """Environment steps of the whole run."""
        return int(self.config["trainer"]["total_steps"])

    @property
    def finished(self) -> bool:
        """Whether the final evaluation of this configuration is there: it is written last."""
        saved = self.path / CONFIG_FILE
        if not (self.path / RESULTS).is_file() or not saved.is_file():
            return False
        made_with = yaml.safe_load(saved.read_text(encoding="utf-8"))
        return measured_settings(made_with) == measured_settings(self.config)

    def prepare(self) -> None:
        """Write the configuration, for a process that starts or resumes the run."""
        self.path.mkdir(parents=True, exist_ok=True)
        (self.path / RESULTS).unlink(missing_ok=True)
        write_config(self.config, self.path)

    def log_tail(self, lines: int = 15) -> str:
        """Return the end of the run's log."""
        try:
            text = self.log.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            return str(error)
        return "\n".join(text.splitlines()[-lines:])


def write_config(config: Mapping[str, Any], run_dir: Path) -> None:
    """Write a run's resolved configuration, all or nothing."""
    write_atomically(run_dir / CONFIG_FILE, yaml.safe_dump(dict(config), sort_keys=False))


def one_seed(config: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Return the configuration of one seed's run; whoever starts several makes the video."""
    trainer = {**config["trainer"], "seed": seed, "num_seeds": 1}
    return {**config, "trainer": trainer, "render": {**config["render"], "enabled": False}}
