"""Where runs are executed: processes on this machine, or tasks of a Ray cluster."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rrl.threads import cores

POLL_SECONDS = 0.2
GRACE_SECONDS = 120.0
"""How long a run that is asked to stop may take to finish its round and save."""

WORKER = (
    "import sys; sys.path[:] = filter(None, sys.path); "
    "from rrl.trainers.cli.worker import run; run()"
)
"""What a run's process executes; as text, because the command line imports this package. Python
puts the working directory first, where a project's files would hide packages of their names."""


class LocalLauncher:
    """A process for each run, with one thread; Ctrl-C in the terminal reaches none of them.

    Args:
        workers: How many at a time; None: as many as this process has cores.

    Attributes:
        slots: How many run at a time.
    """

    def __init__(self, workers: int | None = None) -> None:
        self.slots = workers or cores()

    def start(self, arguments: Sequence[str], log: Path) -> Process:
        """Start ``rrl`` with these arguments; what it prints goes to ``log``."""
        return spawn(arguments, log)

    def close(self) -> None:
        """Do nothing."""


class RayLauncher:
    """A Ray task of one core for each run; all machines share the file system and the installation.

    Connects to the cluster that ``RAY_ADDRESS`` names, or starts one on this machine.

    Args:
        workers: How many at a time; None: as many as the cluster has cores.

    Attributes:
        slots: How many run at a time.

    Raises:
        ModuleNotFoundError: If Ray is not installed.
    """

    def __init__(self, workers: int | None = None) -> None:
        try:
            import ray
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "launcher=ray needs Ray: pip install -e '.[ray]' in the clone"
            ) from error
        self._ray = ray
        if not ray.is_initialized():
            ray.init(log_to_driver=False, include_dashboard=False, configure_logging=False)
        self.slots = workers or int(ray.cluster_resources().get("CPU", 1))
        self._task = ray.remote(num_cpus=1, max_retries=0)(_run)

    def start(self, arguments: Sequence[str], log: Path) -> Task:
        """Submit a task that does as in :class:`LocalLauncher`."""
        task = self._task.remote(list(arguments), str(log), str(Path.cwd()), sys.path)
        return Task(self._ray, task)

    def close(self) -> None:
        """Disconnect; a cluster that was started here ends."""
        self._ray.shutdown()


Launcher = LocalLauncher | RayLauncher
"""Starts ``rrl`` commands."""


def make(name: str, workers: int | None) -> Launcher:
    """Return the launcher ``local`` or ``ray``; ``workers`` as in the classes."""
    return RayLauncher(workers) if name == "ray" else LocalLauncher(workers)


class Process(subprocess.Popen):
    """A run in a process of this machine; ``terminate`` asks it to save and end."""

    def kill(self) -> None:
        """End it at once."""
        super().kill()
        self.wait()


def spawn(
    arguments: Sequence[str], log: Path, cwd: str | None = None, path: Sequence[str] = ()
) -> Process:
    """Start ``rrl`` in a process with one thread, which saves and ends when this process does."""
    one = {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
    found = {"PYTHONPATH": os.pathsep.join(p for p in path if p)} if path else {}
    with log.open("a", encoding="utf-8") as file:
        return Process(
            [sys.executable, "-c", WORKER, str(os.getpid()), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            cwd=cwd,
            env={**os.environ, **one, **found},
            start_new_session=True,
        )


class Task:
    """A run in a Ray task, with the methods of :class:`Process` that the pool uses."""

    def __init__(self, ray: Any, reference: Any) -> None:
        self._ray, self._reference = ray, reference

    def poll(self) -> int | None:
        """Return the exit status, None while it runs."""
        if not self._ray.wait([self._reference], timeout=0)[0]:
            return None
        try:
            return int(self._ray.get(self._reference))
        except self._ray.exceptions.TaskCancelledError:  # before it started
            return 128 + signal.SIGTERM
        except self._ray.exceptions.RayError:  # for instance a lost machine
            return 1

    def terminate(self) -> None:
        """Ask it to save and end."""
        self._ray.cancel(self._reference, recursive=False)

    def kill(self) -> None:
        """End it at once."""
        self._ray.cancel(self._reference, force=True)


Handle = Process | Task
"""A run that was started."""


def _run(arguments: Sequence[str], log: str, cwd: str, path: Sequence[str]) -> int:
    """Run the command as a Ray task; when cancelled, have it save first."""
    # Ray cancels by SIGINT, which is ignored below nohup.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    process = spawn(arguments, Path(log), cwd, path)
    try:
        while process.poll() is None:  # a wait without an end would not see the request
            time.sleep(POLL_SECONDS)
        return process.returncode
    except KeyboardInterrupt:
        process.terminate()
        return process.wait(GRACE_SECONDS)
