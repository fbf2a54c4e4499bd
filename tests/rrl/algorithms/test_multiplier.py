"""A price finds the budget, from wherever it starts."""

import math

import pytest

from rrl import Multiplier


@pytest.mark.parametrize("initial", [0.0, 2.0, 50.0])
def test_the_price_settles_where_the_budget_is_kept(initial):
    price = Multiplier(budget=10.0, rate=0.1, initial=initial)
    assert price.value == initial
    for _ in range(3000):
        price.adapt(30.0 / (1.0 + price.value))  # what is used falls as its price grows
    assert 30.0 / (1.0 + price.value) == pytest.approx(10.0, rel=0.01)


@pytest.mark.parametrize(
    ("argument", "value"),
    [("budget", 0.0), ("rate", -1.0), ("rate", math.inf), ("initial", -0.1)],
)
def test_numbers_out_of_range_are_named(argument, value):
    with pytest.raises(ValueError, match=f"{argument}: expected"):
        Multiplier(**{"budget": 1.0, "rate": 0.1, argument: value})


@pytest.mark.parametrize("sample", [math.nan, math.inf])
def test_the_price_does_not_follow_what_is_no_number(sample):
    price = Multiplier(budget=1.0, rate=0.1, initial=2.0)
    with pytest.raises(ValueError, match=f"sample: expected a finite number, got {sample}"):
        price.adapt(sample)
    assert price.value == 2.0
