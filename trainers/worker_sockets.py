"""A place for the sockets of worker processes, which bear no long name."""

from __future__ import annotations

import os
import tempfile
from multiprocessing import util

__all__ = ["LONGEST_FOLDER", "keep_sockets_short"]

LONGEST_FOLDER = 70
"""Bytes: a socket's path may have 107, of which multiprocessing's own names take up to 35."""


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
