"""Intervals and tests against published values and against their definition."""

import numpy as np
import pytest
from scipy import stats

from rrl.trainers.evaluation.statistics import (
    exact_interval,
    iqm,
    iqm_interval,
    mcnemar,
    mean_interval,
    wilson,
)


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


def test_exact_interval_of_the_papers_table():
    # 15 of 20: Clopper and Pearson's limits as in published tables
    assert exact_interval(15, 20) == (
        pytest.approx(0.5090, abs=1e-4),
        pytest.approx(0.9134, abs=1e-4),
    )
    assert exact_interval(20, 20)[1] == 1.0


def test_exact_interval_covers_at_least_as_often_as_it_says():
    probabilities = stats.binom.pmf(range(21), 20, 0.75)
    covered = [low <= 0.75 <= high for low, high in (exact_interval(n, 20) for n in range(21))]
    assert probabilities @ covered >= 0.95


def test_interquartile_mean_ignores_the_outer_quarters():
    assert iqm([-1000.0, 1.0, 2.0, 1000.0]) == 1.5
    assert iqm([-1000.0, 1.0], [2.0, 1000.0]) == 1.5


def test_bootstrap_of_the_interquartile_mean_covers_it():
    rng = np.random.default_rng(0)
    intervals = [iqm_interval(rng.normal(3.0, 2.0, size=20), resamples=300) for _ in range(200)]
    assert np.mean([low < 3.0 < high for low, high in intervals]) == pytest.approx(0.92, abs=0.06)


def test_strata_that_differ_do_not_widen_the_bootstrap():
    rng = np.random.default_rng(0)
    tasks = [offset + rng.normal(0.0, 0.1, size=10) for offset in (0.0, 5.0, 10.0, 15.0)]
    low, high = iqm_interval(*tasks)
    assert high - low < 0.3
    low, high = iqm_interval(np.concatenate(tasks))  # resampled as if they were one task
    assert high - low > 2.0


def test_bootstrap_of_one_seed_is_its_value():
    assert iqm_interval([0.5]) == (0.5, 0.5)
