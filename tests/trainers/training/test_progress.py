"""How far a run is: bars and log messages on one terminal, plain lines where no bar is drawn."""

import io
import logging
import sys

import numpy as np
import pytest
from rich.console import Console

from rrl.trainers.evaluation.episodes import Comparison, Episodes
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


def test_a_dumb_terminal_gets_a_line_for_every_evaluation(monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    won, diverged = np.array([True, False]), np.zeros(2, bool)
    played = Episodes(np.zeros(2), np.full(2, 3), won, diverged)
    out = io.StringIO()
    progress = Progress(Console(file=out, force_terminal=True))
    with progress.training(20, 0):
        for steps in (10, 20):
            progress.show(Comparison(played, played), steps)
    lines = out.getvalue().splitlines()
    assert [line.split()[:2] for line in lines] == [["10", "steps"], ["20", "steps"]]
