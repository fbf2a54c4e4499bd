"""The process of one run: it saves and ends when the process that started it dies."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

LOOK_SECONDS = 0.5


def follow_parent(parent: int) -> None:
    """Send this process one SIGTERM when ``parent`` dies.

    The kernel's own PR_SET_PDEATHSIG signals once for each thread of the parent that dies, and a
    second signal would end this process without a checkpoint.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_SECONDS)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, name="follow-parent", daemon=True).start()


def run() -> None:
    """Be the process: the arguments are the parent's id and the command."""
    follow_parent(int(sys.argv[1]))
    from .main import main

    sys.exit(main(sys.argv[2:]))
