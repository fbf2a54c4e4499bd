"""Periods begin on a grid that does not move, whatever happened before."""

import threading
import time

import pytest

from rrl.pace import Pace, prioritize, prioritized

PERIOD = 0.02


def periods_since(start, pace):
    return (pace.scheduled - start) / PERIOD


def test_deadlines_do_not_drift():
    pace = Pace(PERIOD)
    pace.start()
    start = pace.scheduled
    for n in range(1, 6):
        time.sleep(0.003)
        pace.wait()
        periods = periods_since(start, pace)
        assert periods == pytest.approx(round(periods))
        assert periods >= n - 0.5  # on a busy machine there may be late ones
        assert pace.began >= pace.scheduled


def test_a_loop_that_was_late_goes_on_without_a_burst():
    pace = Pace(PERIOD)
    pace.start()
    start = pace.scheduled
    time.sleep(3.5 * PERIOD)
    pace.wait()
    periods = periods_since(start, pace)
    assert periods == pytest.approx(round(periods))
    assert periods >= 2.5
    assert pace.error >= 2 * PERIOD
    began = pace.began
    pace.wait()
    assert pace.began > began
    assert pace.began >= pace.scheduled


def test_what_is_done_meanwhile_is_done_once_a_period():
    pace, calls = Pace(PERIOD), []
    pace.meanwhile = lambda: calls.append(time.monotonic())
    pace.wait()
    pace.wait()
    assert len(calls) == 2


def test_a_period_is_positive():
    with pytest.raises(ValueError, match="period: expected a positive number of seconds, got 0"):
        Pace(0)


def test_no_priority_changes_nothing():
    prioritize(0)


def test_threads_that_end_meanwhile_do_not_matter():
    """A thread may end after it was listed and before it gets its priority."""
    over = threading.Event()

    def churn():
        while not over.is_set():
            threads = [threading.Thread(target=time.sleep, args=(0.0005,)) for _ in range(50)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()

    other = threading.Thread(target=churn)
    other.start()
    try:
        for _ in range(100):
            with prioritized(1):
                pass
    finally:
        over.set()
        other.join()


def test_without_linuxs_list_of_threads_it_says_so_and_goes_on(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr("rrl.pace.Path", lambda path: tmp_path / "none")
    with prioritized(1):
        pass
    assert "priority: this system does not let" in caplog.text
