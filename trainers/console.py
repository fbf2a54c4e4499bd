"""Where the commands print: nothing to copy is wrapped, and no run ends with its terminal."""

from __future__ import annotations

import codecs
import io
import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import ClassVar, TextIO

from rich.console import Console
from rich.segment import Segment, Segments

__all__ = ["DurableStream", "Output", "durable_output", "from_here", "shows_bars"]

AS_BYTES = "rrl.as_bytes"
"""How streams write what their encoding lacks: parts of a path as the bytes that they are, so that
a command can be pasted, and all else escaped."""
WIDE = 10_000
"""Columns of what is no terminal: nothing is wrapped there."""


def _as_bytes(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    escaped = codecs.lookup_error("surrogateescape")
    try:
        return escaped(error)
    except UnicodeEncodeError:
        return codecs.lookup_error("backslashreplace")(error)


codecs.register_error(AS_BYTES, _as_bytes)


def from_here(*command: str) -> str:
    """Return a command to copy, which runs in this folder wherever it is pasted.

    A project's modules, its ``configs/`` and relative paths are found from its folder.
    """
    return f"cd {shlex.quote(str(Path.cwd()))} && {shlex.join(command)}"


def shows_bars(console: Console) -> bool:
    """Return whether a console draws over what it has drawn, as a progress bar needs.

    A file and a pipe do not, nor does a terminal with TERM=dumb, such as Emacs' shell.
    """
    return console.is_terminal and not console.is_dumb_terminal


class Output(Console):
    """A console that shows text as it is: no markup, no emoji, no line breaks of its own.

    Args:
        stderr: Whether to write to standard error.
        file: Where to write instead.
    """

    def __init__(self, *, stderr: bool = False, file: TextIO | None = None) -> None:
        stream = file or (sys.stderr if stderr else sys.stdout)
        width = None if getattr(stream, "isatty", bool)() else WIDE
        super().__init__(
            stderr=stderr, file=file, width=width, markup=False, emoji=False, highlight=False
        )

    def say(self, text: object, style: str | None = None) -> None:
        """Print a line that can be copied, a path or a command, as it is, tabs included."""
        line = Segment(f"{text}\n", self.get_style(style) if style else None)
        self.print(Segments([line]), end="", soft_wrap=True)


class DurableStream(io.TextIOBase):
    """A text stream that outlives its reader: when writing fails, the text goes to a file instead.

    Args:
        stream: Standard output or standard error.
    """

    log: ClassVar[Path | None] = None
    """The file, as soon as there is a run's directory; before, the text is dropped."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=AS_BYTES)

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Encoding of the stream."""
        return getattr(self._stream, "encoding", None) or "utf-8"

    def isatty(self) -> bool:
        """Return whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the stream's file descriptor."""
        return self._stream.fileno()

    def writable(self) -> bool:
        """Return True."""
        return True

    def write(self, text: str) -> int:
        """Write to the stream, or to the file."""
        try:
            self._stream.write(text)
        except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: within a signal
            self._go_on_without(error, text)
        return len(text)

    def flush(self) -> None:
        """Flush the stream."""
        try:
            self._stream.flush()
        except (OSError, ValueError, RuntimeError) as error:
            self._go_on_without(error)

    def _go_on_without(self, error: Exception, text: str = "") -> None:
        """Let the stream's file descriptor, and with it all that is buffered, end in the file.

        ``text`` is what could not be written; with PYTHONUNBUFFERED it is not in the buffer.
        """
        if isinstance(error, RuntimeError):
            return
        try:
            with (self.log or Path(os.devnull)).open("a", encoding="utf-8") as file:
                file.write(f"the output cannot be written ({error}); it goes on here\n")
                file.flush()
                os.dup2(file.fileno(), self._stream.fileno())
            if getattr(self._stream, "write_through", False):
                self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError):
            with suppress(OSError, ValueError):  # what is left in its buffer must not fail at exit
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            self._stream = open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123, SIM115


@contextmanager
def durable_output() -> Iterator[None]:
    """Make standard output and error durable while the body runs."""
    with ExitStack() as stack:
        for redirect, stream in ((redirect_stdout, sys.stdout), (redirect_stderr, sys.stderr)):
            if stream is None:  # closed before the process started: keep its number from files
                os.open(os.devnull, os.O_RDWR)
                stream = stack.enter_context(Path(os.devnull).open("w"))
            stack.enter_context(redirect(DurableStream(stream)))
        try:
            yield
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
