"""Signals that would end Python without any clean-up raise instead, and wait where they must."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

CLEAN_UP = 10.0
"""Seconds after a signal in which those that follow it do not disturb the clean-up."""

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def raised_as_exits() -> Iterator[None]:
    """Have SIGTERM and SIGHUP (a closed terminal) raise ``SystemExit`` within the block.

    The status is what a shell expects, 128 + n. Who ends a session sends both at once: one that
    follows within :data:`CLEAN_UP` seconds is dropped. Only the main thread hears signals. One that
    the program ignores, or has a handler for, is left alone.
    """
    ends = -float("inf")

    def leave(number: int, frame: object) -> None:
        nonlocal ends
        if time.monotonic() > ends:
            ends = time.monotonic() + CLEAN_UP
            raise SystemExit(128 + number)

    in_main = threading.current_thread() is threading.main_thread()
    numbers = [signal.SIGTERM, signal.SIGHUP] if in_main else []
    heard = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]
    for number in heard:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number in heard:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def held_back() -> Iterator[None]:
    """Hold SIGINT, SIGTERM and SIGHUP back until the block has ended, then let them come.

    For what has to be done to its end, such as telling a robot to stop. Only the main thread hears
    signals; elsewhere nothing is done.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handlers = {number: signal.getsignal(number) for number in ENDING}
    held = {n: h for n, h in handlers.items() if h not in (signal.SIG_IGN, None)}
    try:
        for number in held:
            signal.signal(number, lambda number, frame: came.append(number))
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
        for late in came:
            signal.raise_signal(late)
