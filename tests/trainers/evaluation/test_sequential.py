"""The sequential test errs no more often than it says, and is quick where the answer is clear."""

import numpy as np
import pytest
from scipy import stats

from benchmarks import acceptance
from rrl.trainers.evaluation.sequential import ErrorBudget, NotWorseTest

RUNS = 300


@pytest.mark.parametrize("good", [0.0, 0.3])
@pytest.mark.parametrize("draw", acceptance.DRAWS)
@pytest.mark.parametrize("controller", [0.1, 0.5, 0.9])
def test_a_run_of_policies_worse_by_the_margin_rarely_accepts_any(controller, draw, good):
    rate = acceptance.false_acceptance(controller, draw, candidates=10, good=good, runs=RUNS)
    found = stats.binomtest(round(rate * RUNS), RUNS, 0.05, alternative="greater")
    assert found.pvalue > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("draw", acceptance.DRAWS)
def test_however_many_candidates_there_are(draw):
    rate = acceptance.false_acceptance(0.9, draw, candidates=100, good=0.2, runs=1000)
    assert stats.binomtest(round(rate * 1000), 1000, 0.05, alternative="greater").pvalue > 0.01


@pytest.mark.parametrize(
    ("controller", "policy", "accepted", "pairs"),
    [
        (1.0, 1.0, 1.0, 110),  # equal, and equal in every episode
        (0.95, 1.0, 0.99, 80),
        (0.9, 0.95, 0.9, 100),
        (0.2, 0.9, 0.99, 15),
    ],
)
def test_pairs_that_a_policy_needs(controller, policy, accepted, pairs):
    share, count = acceptance.power(controller, policy, "frozen", runs=200)
    assert share >= accepted
    assert count <= pairs


@pytest.mark.parametrize(("policy", "pairs"), [(0.7, 40), (0.4, 15)])
def test_a_bad_policy_is_given_up_soon(policy, pairs):
    share, count = acceptance.power(0.9, policy, "frozen", runs=200)
    assert share == 0
    assert count <= pairs


def test_a_policy_as_good_as_the_controller_is_seldom_given_up():
    rng, tests = np.random.default_rng(0), []
    for _ in range(300):
        tests.append(NotWorseTest(0.05, 0.01))
        tests[-1].add(acceptance.pairs(0.5, 0.5, 200, rng))
    assert np.mean([test.decided and not test.accepted for test in tests]) <= 0.2


def test_candidates_that_promise_more_are_the_ones_to_test():
    ends = {
        (rule, curve): acceptance.rule(rule, curve, runs=60)
        for rule in acceptance.RULES
        for curve in ("rises above 30 %", "rises above 20 %, then collapses")
    }
    ours, *others = acceptance.RULES
    for curve in ("rises above 30 %", "rises above 20 %, then collapses"):
        success, pairs = ends[ours, curve]
        for other in others:
            assert success >= ends[other, curve][0] - 0.02
            assert pairs <= ends[other, curve][1]


def test_episodes_may_come_in_parts():
    differences = acceptance.pairs(0.5, 0.7, 200, np.random.default_rng(1))
    whole, parts = NotWorseTest(0.05, 0.0125), NotWorseTest(0.05, 0.0125)
    whole.add(differences)
    for first in range(0, 200, 7):
        parts.add(differences[first : first + 7])
    assert whole.decided
    assert (parts.episodes, parts.accepted) == (whole.episodes, whole.accepted)
    assert parts.wealth == pytest.approx(whole.wealth)
    before = whole.wealth
    whole.add([-1.0] * 50)  # too late
    assert (whole.wealth, whole.accepted) == (before, True)


def test_what_is_no_number_counts_as_lost_and_nothing_counts_beyond_one():
    odd, plain = NotWorseTest(0.05, 0.01), NotWorseTest(0.05, 0.01)
    odd.add([np.nan, 5.0, -7.0])
    plain.add([-1.0, 1.0, -1.0])
    assert odd.wealth == plain.wealth
    assert np.isfinite(odd.wealth)


def test_a_policy_that_seldom_fails_at_great_cost_is_not_taken_for_one_that_does_not():
    rng, worse = np.random.default_rng(0), -0.1

    def accepted(largest):
        tests = [NotWorseTest(0.05 / largest, 0.0125) for _ in range(RUNS)]
        for test in tests:
            test.add(acceptance.rare_failures(0.0, worse, 200, rng) / largest)
        return np.mean([test.accepted for test in tests])

    assert accepted(acceptance.FAILURE) <= 0.0125
    assert accepted(1.0) > 0.1  # what a bound of one range would let through


def test_a_wide_bound_does_not_keep_a_much_better_policy_out():
    test = NotWorseTest(0.05 / 100, 0.0125)
    test.add(np.full(200, 12 / 100))  # twelve ranges better, where a hundred may be lost
    assert test.accepted
    assert test.episodes <= 60


def test_an_accepted_candidate_gives_its_stake_back_and_a_lost_one_what_its_wealth_is_worth():
    budget = ErrorBudget(0.05)
    test = budget.test(0.05)
    test.add([1.0] * 20)
    budget.settle(test)
    assert test.accepted
    assert budget.left == 0.05
    untouched = budget.test(0.05)
    budget.settle(untouched)
    assert budget.left == 0.05
    for _ in range(100):
        test = budget.test(0.05)
        test.add([-1.0] * 200)
        before = budget.left
        budget.settle(test)
        assert 0 < budget.left < before
    promising = budget.test(0.05)
    promising.add([0.0] * 20)
    assert promising.wealth > 1
    before = budget.left
    budget.settle(promising)
    assert budget.left == before
