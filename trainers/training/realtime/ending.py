"""How the acting process is asked to end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class Ending:
    """Remembers that the acting process was asked to end, by a signal; whoever acts looks at it.

    Attributes:
        is_asked: Whether it was.
    """

    def __init__(self) -> None:
        self.is_asked = False
        self._at_once = False

    def ask(self, *_: object) -> None:
        """Ask it to end, as the handler of a signal.

        Raises:
            SystemExit: Inside of :meth:`at_once`.
        """
        self.is_asked = True
        if self._at_once:
            raise SystemExit

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Leave the body at once when asked: it takes long, and nothing in it looks.

        Raises:
            SystemExit: If it is asked, or was before. No ``except Exception`` in a robot's driver
                keeps it.
        """
        self._at_once = True
        try:
            if self.is_asked:
                raise SystemExit
            yield
        finally:
            self._at_once = False
