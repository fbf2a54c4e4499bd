"""Log messages pass through the progress bar and come out where they came out before."""

import io
import logging
import sys

import pytest
from rich.console import Console

from rrl.trainers.training.progress import Progress


@pytest.fixture
def handler():
    handler = logging.StreamHandler(sys.__stdout__)
    logging.getLogger().addHandler(handler)
    yield handler
    logging.getLogger().removeHandler(handler)


@pytest.mark.parametrize("terminal", [True, False])
def test_a_handler_writes_where_the_bar_is_and_then_as_before(monkeypatch, handler, terminal):
    monkeypatch.setattr(sys, "stdout", sys.__stdout__)
    out = io.StringIO()
    with Progress(Console(file=out, force_terminal=terminal)).training(10, 0):
        assert (handler.stream is sys.__stdout__) == (not terminal)
        if terminal:
            logging.getLogger("rrl").warning("compiling")
    assert handler.stream is sys.__stdout__
    assert ("compiling" in out.getvalue()) == terminal
