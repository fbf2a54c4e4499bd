"""What every logger is: a sink for metrics, media and tables, whose failure does not stop a run."""

from __future__ import annotations

import contextlib
import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from .metrics import Values

_log = logging.getLogger(__name__)

Rows = Sequence[Sequence[Any]]
"""Rows of a table: text, numbers, booleans or None."""


class MetricsLogger(ABC):
    """A sink for metrics and media.

    ``start`` is called once, then ``log`` with steps that never fall.
    """

    @abstractmethod
    def start(self, run_dir: Path, config: Mapping[str, Any], env_steps: int) -> None:
        """Open the sink and forget what was logged after ``env_steps``, where the sink can.

        Args:
            run_dir: The run's directory.
            config: The run's configuration.
            env_steps: Environment step from which the run goes on; 0 for a new run.
        """

    @abstractmethod
    def log(self, values: Values, env_steps: int) -> None:
        """Record metrics."""

    def log_file(self, name: str, path: Path, env_steps: int) -> None:  # noqa: B027 - optional
        """Record a picture (``.png``) or a video (``.mp4``, ``.gif``)."""

    def log_table(  # noqa: B027 - optional
        self, name: str, columns: Sequence[str], rows: Rows, env_steps: int
    ) -> None:
        """Record a table."""

    def flush(self) -> None:  # noqa: B027 - optional
        """Put on disk what was logged; called before every checkpoint."""

    def finish(self) -> None:  # noqa: B027 - optional
        """Flush and close."""


class Guarded:
    """A logger whose failure is reported once and does not stop the run.

    It has the methods of :class:`MetricsLogger`. One that was not started does nothing.

    Args:
        logger: The logger; not used any more after its first error.
    """

    def __init__(self, logger: MetricsLogger) -> None:
        self.logger = logger
        self._running, self._broken = False, False

    def __getattr__(self, method: str) -> Callable[..., None]:
        return partial(self._try, method)

    def start(self, run_dir: Path, config: Mapping[str, Any], env_steps: int) -> None:
        """Open the sink, which an earlier call may have opened."""
        self.finish()
        self._running, self._broken = True, False
        self._try("start", run_dir, config, env_steps)

    def finish(self) -> None:
        """Close a sink that was opened; one that is broken may fail silently."""
        if self._broken:
            with contextlib.suppress(Exception):
                self.logger.finish()
        self._try("finish")
        self._running = False

    def _try(self, method: str, *arguments: Any) -> None:
        if not self._running or self._broken:
            return
        try:
            getattr(self.logger, method)(*arguments)
        except Exception as error:  # whatever a sink or its network can come up with
            self._broken = True
            name, kind = type(self.logger).__name__, type(error).__name__
            _log.warning("%s failed (%s: %s); training goes on without it", name, kind, error)
