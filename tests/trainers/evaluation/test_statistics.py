"""Intervals and tests against published values and against their definition."""

import numpy as np
import pytest
from scipy import stats

from benchmarks import coverage
from rrl.trainers.evaluation.statistics import (
    fisher,
    iqm,
    iqm_interval,
    mcnemar,
    mean_interval,
    paired_interval,
    rate_interval,
    success_interval,
    unpaired_interval,
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


def test_one_run_says_nothing_about_others():
    assert np.isnan(mean_interval([0.5])).all()
    assert np.isnan(iqm_interval([0.5])).all()
    assert np.isnan(iqm_interval([0.5, 0.6], [0.5])).all()


def test_a_return_that_is_no_number_has_no_interval():
    assert np.isnan(iqm_interval([0.5, 0.6, 0.7, np.nan], [0.5, 0.6])).all()
    assert rate_interval([15], 20) == wilson(15, 20)
    assert success_interval([[True] * 15 + [False] * 5]) == wilson(15, 20)


def test_mcnemar_is_the_sign_test_of_changed_episodes():
    assert mcnemar(0, 0) == 1.0
    assert mcnemar(5, 5) == 1.0
    assert mcnemar(10, 0) == pytest.approx(2 / 2**10)


def test_a_success_rate_never_has_an_interval_of_zero_width():
    for runs in (1, 2, 3, 10):
        low, high = rate_interval([100] * runs, 100)
        assert low < 0.999
        assert high == 1.0
        low, high = rate_interval([0] * runs, 100)
        assert low == 0.0
        assert high > 0.001
        low, high = rate_interval([50] * runs, 100)
        assert 0.3 < low < 0.49
        assert 0.51 < high < 0.7


def test_success_and_failure_are_alike():
    low, high = rate_interval([90, 95, 99], 100)
    mirrored = rate_interval([10, 5, 1], 100)
    assert (1 - high, 1 - low) == pytest.approx(mirrored, abs=1e-6)


def test_more_runs_narrow_the_interval_and_spread_widens_it():
    def width(*counts):
        low, high = rate_interval(counts, 100)
        return high - low

    assert width(*[90] * 10) < width(*[90] * 5) < width(*[90] * 3)
    assert width(90, 90, 90, 90, 90) < width(80, 85, 90, 95, 100)


def test_many_alike_runs_are_about_as_good_as_their_episodes_together():
    low, high = rate_interval([70] * 50, 100)
    pooled = wilson(3500, 5000)
    assert low == pytest.approx(pooled[0], abs=0.004)
    assert high == pytest.approx(pooled[1], abs=0.004)


def test_counts_that_cannot_be_are_refused():
    for counts in ([], [101], [-1]):
        with pytest.raises(ValueError, match="expected counts from 0 to 100"):
            rate_interval(counts, 100)


def test_where_luck_is_the_episodes_more_runs_say_no_more_than_one():
    for solved in ([True] * 90 + [False] * 10, [True] * 100):
        low, high = success_interval([solved] * 10)
        once = wilson(sum(solved), 100)
        assert low <= once[0] + 0.015
        assert high >= once[1] - 0.015


def test_where_luck_is_the_runs_own_episodes_count_each():
    table = np.zeros((10, 100), dtype=bool)
    for run in range(10):  # every episode is solved by nine of ten
        table[run] = np.arange(100) % 10 != run
    assert success_interval(table) == rate_interval([90] * 10, 100)


# Coverage of 95 % is not to be had everywhere: benchmarks/coverage.py prints the whole table. Few
# runs that are alike are covered too often, because nobody can know that they are.
@pytest.mark.parametrize(
    ("mean", "spread", "runs", "alike", "low", "high"),
    [
        (0.5, 0.1, 5, 0.0, 0.90, 0.98),
        (0.7, 0.05, 10, 0.0, 0.92, 0.98),
        (0.9, 0.02, 10, 0.0, 0.93, 0.99),
        (0.9, 0.1, 3, 0.0, 0.90, 0.98),
        (0.95, 0.05, 5, 0.0, 0.90, 0.97),
        (0.99, 0.02, 3, 0.0, 0.90, 0.99),
        (0.99, 0.0, 10, 0.0, 0.93, 1.0),
        (0.9, 0.02, 10, 0.5, 0.92, 0.99),
        (0.9, 0.02, 10, 1.0, 0.91, 0.99),
        (0.5, 0.0, 5, 1.0, 0.93, 0.99),
        (0.95, 0.0, 10, 0.8, 0.90, 1.0),
    ],
)
def test_success_interval_covers_about_as_often_as_it_says(mean, spread, runs, alike, low, high):
    covered, _ = coverage.success_coverage(mean, spread, runs, studies=400, alike=alike)
    assert low <= covered <= high


@pytest.mark.parametrize("runs", [1, 3])
def test_paired_interval_covers_at_least_about_as_often_as_it_says(runs):
    covered, width = coverage.paired_coverage(0.5, 0.9, 0.0, runs, studies=400)
    assert covered >= 0.92
    assert width < 0.25


@pytest.mark.parametrize("runs", [1, 3])
def test_paired_interval_of_several_tasks_covers_their_mean_and_is_narrower(runs):
    _, one = coverage.paired_coverage(0.5, 0.9, 0.05, runs, studies=100)
    covered, width = coverage.paired_coverage(0.5, 0.9, 0.05, runs, studies=400, tasks=4)
    assert covered >= (0.92 if runs > 1 else 0.85)  # one run knows nothing of the spread of runs
    assert width == pytest.approx(one / 2, rel=0.2)


def test_paired_interval_of_unequal_tasks_weighs_each_alike():
    low, high = paired_interval([[0.0, 0.2], [0.1, 0.3]], [[1.0], [1.2]])
    assert (low + high) / 2 == pytest.approx((0.15 + 1.1) / 2)
    assert np.isnan(paired_interval([[0.0, 0.2], [0.1, 0.3]], [[1.0]])).all()


def test_paired_interval_is_bonetts_and_prices_for_one_run():
    # 12 rescued, 2 broken of 100: (12 + 1 - 2 - 1) / 102 and its standard error, by hand
    differences = np.repeat([1.0, -1.0, 0.0], [12, 2, 86])
    low, high = paired_interval(differences, bound=1.0)
    assert (low + high) / 2 == pytest.approx(10 / 102)
    error = np.sqrt((16 / 102 - (10 / 102) ** 2) / 102)
    assert high - low == pytest.approx(2 * 1.98 * error, rel=0.02)
    low, high = paired_interval(np.zeros((3, 50)), bound=1.0)
    assert low < 0 < high


@pytest.mark.parametrize("runs", [1, 3, 10])
@pytest.mark.parametrize(("controller", "policy"), [(0.5, 0.9), (0.9, 0.95), (0.1, 0.1)])
def test_unpaired_interval_covers_at_least_about_as_often_as_it_says(controller, policy, runs):
    covered, width = coverage.unpaired_coverage(controller, policy, 0.0, runs, studies=400)
    assert covered >= 0.92
    assert width < (0.4 if runs > 1 else 0.3)


def test_unpaired_interval_is_agrestis_and_caffos_for_one_run():
    # 30 of 40 against 20 of 40, by hand: (31/42 - 21/42) and the two variances
    first, second = (np.repeat([1.0, 0.0], [k, 40 - k]) for k in (30, 20))
    low, high = unpaired_interval(first, second, bound=1.0)
    p, q = 31 / 42, 21 / 42
    assert (low + high) / 2 == pytest.approx(p - q)
    error = np.sqrt(p * (1 - p) / 42 + q * (1 - q) / 42)
    assert high - low == pytest.approx(2 * 1.99 * error, rel=0.02)
    low, high = unpaired_interval(np.ones(40), np.ones(40), bound=1.0)
    assert -0.2 < low < 0 < high < 0.2


def test_unpaired_interval_of_returns_is_welchs():
    rng = np.random.default_rng(0)
    first, second = rng.normal(1.0, 1.0, 50), rng.normal(0.0, 3.0, 80)
    expected = stats.ttest_ind(first, second, equal_var=False).confidence_interval(0.95)
    assert unpaired_interval(first, second) == pytest.approx((expected.low, expected.high))
    assert np.isnan(unpaired_interval([1.0], [2.0])).all()


@pytest.mark.parametrize("value", [0.0, 0.1, 1.0, -1234.56])
@pytest.mark.parametrize("runs", [2, 3, 7, 10])
def test_equal_values_have_an_interval_with_a_width_or_none(value, runs):
    alike = np.full((runs, 30), value)
    odd = np.append(np.full(19, value), value + 1.0)  # which the bootstrap hardly ever sees
    unbounded = [
        mean_interval(alike[:, 0]),
        iqm_interval(alike[:, 0]),
        iqm_interval(alike[:, 0], alike[:, 0]),
        iqm_interval(odd),
        paired_interval(alike),
        paired_interval(alike, alike),
        unpaired_interval(alike, alike),
    ]
    assert np.isnan(unbounded).all()
    if 0 <= value <= 1:
        for low, high in (
            wilson(round(30 * value), 30),
            rate_interval([round(30 * value)] * runs, 30),
            success_interval(alike >= 0.5),
            paired_interval(alike, bound=1.0),
            unpaired_interval(alike, alike, bound=1.0),
        ):
            assert low < high


def test_fishers_test_knows_no_pairs():
    assert fisher(10, 10, 20) == 1.0
    assert fisher(20, 0, 20) == pytest.approx(2 / 137846528820)  # two of C(40, 20) tables
    assert fisher(15, 5, 20) == fisher(5, 15, 20) < 0.01


def test_interquartile_mean_ignores_the_outer_quarters():
    assert iqm([-1000.0, 1.0, 2.0, 1000.0]) == 1.5
    assert iqm([-1000.0, 1.0], [2.0, 1000.0]) == 1.5


def test_bootstrap_of_the_interquartile_mean_covers_it():
    rng = np.random.default_rng(0)
    intervals = [iqm_interval(rng.normal(3.0, 2.0, size=20)) for _ in range(200)]
    assert np.mean([low < 3.0 < high for low, high in intervals]) == pytest.approx(0.92, abs=0.06)


def test_strata_that_differ_do_not_widen_the_bootstrap():
    rng = np.random.default_rng(0)
    tasks = [offset + rng.normal(0.0, 0.1, size=10) for offset in (0.0, 5.0, 10.0, 15.0)]
    low, high = iqm_interval(*tasks)
    assert high - low < 0.3
    low, high = iqm_interval(np.concatenate(tasks))  # resampled as if they were one task
    assert high - low > 2.0
