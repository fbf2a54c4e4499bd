"""The process of one run: ``rrl train``, ended with a checkpoint when the process that started it dies."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

LOOK_SECONDS = 0.5


def follow_parent(parent: int) -> None:
    """Send this process one SIGTERM when ``parent`` dies; a second one would end it without a checkpoint.

    The kernel's own PR_SET_PDEATHSIG signals once for each thread of the parent that dies.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(LOOK_SECONDS)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, name="follow-parent", daemon=True).start()


if __name__ == "__main__":
    follow_parent(int(sys.argv[1]))
    from ..cli.main import main

    sys.exit(main(sys.argv[2:]))
