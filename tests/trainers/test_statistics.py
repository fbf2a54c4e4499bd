"""Intervals and tests against published values and against their definition."""

import numpy as np
import pytest

from rrl.trainers.statistics import mcnemar, mean_interval, wilson


def test_wilson_interval_of_the_papers_table():
    # 15 of 20, computed by hand from Wilson's formula
    low, high = wilson(15, 20)
    assert (low, high) == (pytest.approx(0.5313, abs=1e-4), pytest.approx(0.8881, abs=1e-4))


def test_mean_interval_covers_the_mean_as_often_as_it_says():
    rng = np.random.default_rng(0)
    intervals = [mean_interval(rng.normal(3.0, 2.0, size=5)) for _ in range(2000)]
    assert np.mean([low < 3.0 < high for low, high in intervals]) == pytest.approx(0.95, abs=0.02)


def test_mean_interval_of_one_value_is_that_value():
    assert mean_interval([0.5]) == (0.5, 0.5)


def test_mcnemar_is_the_sign_test_of_changed_episodes():
    assert mcnemar(0, 0) == 1.0
    assert mcnemar(5, 5) == 1.0
    assert mcnemar(10, 0) == pytest.approx(2 / 2**10)
