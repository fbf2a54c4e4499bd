"""Workers of a parallel batch of environments: why one ended, and a place for their sockets."""

from __future__ import annotations

import os
import shutil
import tempfile
import traceback
import weakref
from collections.abc import Callable
from functools import partial
from multiprocessing import util
from pathlib import Path
from typing import Any

from torchrl.envs import EnvBase

from .errors import place

__all__ = ["LONGEST_FOLDER", "WorkerErrors", "keep_sockets_short"]

LONGEST_FOLDER = 70
"""Bytes: a socket's path may have 107, of which multiprocessing's own names take up to 35."""


class WorkerErrors:
    """Collects what the environments of a :class:`torchrl.envs.ParallelEnv` raise.

    TorchRL tells the parent only that a worker is dead; the reason is printed by another process.
    """

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="rrl-workers-"))
        weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)

    def reporting(self, make: Callable[[], EnvBase], index: int) -> Callable[[], EnvBase]:
        """Return ``make`` for worker ``index``, whose environment leaves its errors behind."""
        return partial(_make, make, self._folder / f"{index:06d}")

    def explained(self, error: RuntimeError) -> RuntimeError:
        """Return an error that names the workers that ended and what they raised."""
        reports = sorted(self._folder.iterdir())
        reasons = [
            f"worker {int(path.name)}: {path.read_text(encoding='utf-8')}" for path in reports
        ]
        told = "; ".join(reasons) or "it left no word, so it was killed or crashed"
        return RuntimeError(
            f"environment: {told} ({error}). Everything before is on disk: the newest checkpoint "
            "and all transitions that were stored"
        )


def _make(make: Callable[[], EnvBase], report: Path) -> EnvBase:
    def guarded(call: Callable[..., Any]) -> Callable[..., Any]:
        def run(*args: Any, **kwargs: Any) -> Any:
            try:
                return call(*args, **kwargs)
            except BaseException as error:  # SystemExit too: the worker ends with it
                text = traceback.format_exception_only(error)[-1].strip() + place(error)
                report.write_text(text, encoding="utf-8", errors="surrogateescape")
                raise

        return run

    env: EnvBase = guarded(make)()
    for method in ("_step", "_reset"):  # what TorchRL has environments implement
        object.__setattr__(env, method, guarded(getattr(env, method)))
    return env


def keep_sockets_short() -> None:
    """Let multiprocessing put sockets in ``/tmp`` where the temporary folder has too long a name.

    It chooses its folder once a process, and processes that are started later take it over.
    Without this a worker ends with "AF_UNIX path too long".
    """
    chosen = tempfile.gettempdir()
    if os.name != "posix" or len(os.fsencode(chosen)) <= LONGEST_FOLDER:
        return
    tempfile.tempdir = "/tmp"
    try:
        util.get_temp_dir()
    finally:
        tempfile.tempdir = chosen
