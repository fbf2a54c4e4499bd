"""The person beside a run."""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ..requests import Request
from .collection import Collection
from .interruption import Interruption

log = logging.getLogger(__name__)


class Person:
    """What a person may ask of a run, from any thread.

    Args:
        collection: Passes requests to whatever plays.
        interruption: Stops the run.
    """

    def __init__(self, collection: Collection, interruption: Interruption) -> None:
        self._collection, self._interruption = collection, interruption
        collection.requests.check = interruption.check
        interruption.when_asked.append(collection.release)
        interruption.at_once.append(collection.stop_at_once)

    @property
    def paused(self) -> bool:
        """Whether the environment stands still, or will before its next step."""
        return self._collection.requests.paused

    def pause(self) -> None:
        """Let the environment stand still before its next step, until :meth:`go_on`."""
        self._ask(Request.PAUSE)

    def go_on(self) -> None:
        """End a pause."""
        self._ask(Request.GO_ON)

    def stop(self) -> None:
        """Finish this round, save and end, as Ctrl-C does; a pause ends too."""
        self._interruption.ask(signal.SIGINT)

    def succeeded(self) -> None:
        """End the episode after the step under way, as a success."""
        self._ask(Request.SUCCEEDED)

    def failed(self) -> None:
        """End the episode after the step under way, as a failure."""
        self._ask(Request.FAILED)

    def repeat_start(self) -> None:
        """Begin the next episode as this one began."""
        self._ask(Request.REPEAT)

    @contextmanager
    def putting_back(self, put_back: Callable[[], None]) -> Iterator[None]:
        """Call ``put_back`` if a signal ends the process at once while the body runs."""
        self._interruption.at_once.append(put_back)
        try:
            yield
        finally:
            self._interruption.at_once.remove(put_back)

    def _ask(self, request: Request) -> None:
        log.info("a person: %s", request.value)
        self._collection.tell(request)
