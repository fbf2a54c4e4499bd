"""The process of one run: ``rrl train``, ended with a checkpoint when the process that started it dies."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1
"""Linux: which signal a process gets when its parent dies."""


def follow_parent(parent: int) -> None:
    """Have SIGTERM sent to this process when ``parent`` dies; on systems other than Linux, do nothing."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it died before
        sys.exit(128 + signal.SIGTERM)


if __name__ == "__main__":
    follow_parent(int(sys.argv[1]))
    from ..cli import main

    sys.exit(main(sys.argv[2:]))
