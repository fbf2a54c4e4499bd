"""How many threads there are to use."""

import os

import pytest

from rrl.threads import available_threads, cores


@pytest.mark.parametrize(
    ("value", "expected"), [("3", 3), ("2,4", 2), (" 5 ", 5), ("", 0), ("0", 0), ("all", 0)]
)
def test_the_openmp_variable_comes_before_the_cores(monkeypatch, value, expected):
    monkeypatch.setenv("OMP_NUM_THREADS", value)
    assert available_threads() == (expected or cores())


def test_the_cores_are_those_that_the_process_may_use():
    assert 1 <= cores() <= (os.cpu_count() or 1)
