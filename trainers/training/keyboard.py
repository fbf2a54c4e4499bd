"""Keys in the terminal, for the person beside a run."""

from __future__ import annotations

import logging
import os
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from .person import Person

KEYS: dict[str, tuple[str, Callable[[Person], None]]] = {
    " ": ("pause, go on", lambda person: person.go_on() if person.paused else person.pause()),
    "y": ("this one succeeded", Person.succeeded),
    "n": ("this one failed", Person.failed),
    "r": ("repeat this start", Person.repeat_start),
    "q": ("save and stop", Person.stop),
}
"""What each key does, in words and by a call."""

SECONDS = 0.1
"""How often the terminal is looked at."""

log = logging.getLogger(__name__)


@contextmanager
def listening(person: Person, enabled: bool = True) -> Iterator[None]:
    """Let a person ask by keys while the body runs, if standard input is a terminal.

    Keys are read one by one and not shown; Ctrl-C stays what it is. The terminal is put back
    whatever ends the body, also when a second signal ends the process at once. In the background of
    a shell nothing is read.

    Args:
        person: Who is asked.
        enabled: Whether to listen at all.
    """
    fd = _terminal() if enabled else None
    if fd is None:
        yield
        return
    before = termios.tcgetattr(fd)
    stopped = threading.Event()

    def put_back() -> None:
        stopped.set()
        if _in_foreground(fd):
            with suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(fd, termios.TCSADRAIN, before)

    log.info("keys: %s", "; ".join(f"{_name(key)} {what}" for key, (what, _) in KEYS.items()))
    thread = threading.Thread(target=_read, args=(fd, person, stopped), name="keys", daemon=True)
    with person.putting_back(put_back):
        thread.start()
        try:
            yield
        finally:
            stopped.set()
            thread.join()
            put_back()


def _read(fd: int, person: Person, stopped: threading.Event) -> None:
    with suppress(OSError, termios.error):  # the terminal is gone: nobody asks anything any more
        while not stopped.is_set():
            if not _in_foreground(fd):
                stopped.wait(SECONDS)
                continue
            if termios.tcgetattr(fd)[3] & termios.ICANON:  # at first, and after a stop by Ctrl-Z
                tty.setcbreak(fd, termios.TCSADRAIN)
            if select.select([fd], [], [], SECONDS)[0]:
                key = os.read(fd, 1)
                if not key:
                    return
                if (asked := KEYS.get(key.decode(errors="replace"))) is not None:
                    asked[1](person)


def _terminal() -> int | None:
    """Return standard input's number, if it is a terminal."""
    try:
        fd = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):  # closed, or replaced
        return None
    return fd if os.isatty(fd) else None


def _in_foreground(fd: int) -> bool:
    try:
        return os.tcgetpgrp(fd) == os.getpgrp()
    except OSError:  # not the terminal that controls this process
        return False


def _name(key: str) -> str:
    return "space" if key == " " else key
