"""Signals that would end Python without any clean-up raise instead."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def raised_as_exits() -> Iterator[None]:
    """Have SIGTERM and SIGHUP (a closed terminal) raise ``SystemExit`` within the block.

    The status is what a shell expects, 128 + n. Only the main thread hears signals. One that the
    program ignores, or has a handler for, is left alone.
    """
    in_main = threading.current_thread() is threading.main_thread()
    numbers = [signal.SIGTERM, signal.SIGHUP] if in_main else []
    heard = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]
    for number in heard:
        signal.signal(number, _exit)
    try:
        yield
    finally:
        for number in heard:
            signal.signal(number, signal.SIG_DFL)


def _exit(number: int, frame: object) -> None:
    raise SystemExit(128 + number)
