"""Titles of panels: a quantity by its name, with its unit."""

import pytest

from rrl.trainers.report.panels import agreed, budgets, quantities, quantity_title

DECLARED = {"contact_force": {"unit": "N"}}


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("constraint/contact_force/episode", "contact force of an episode [N]"),
        ("constraint/contact_force/multiplier", "contact force, price of the budget"),
        ("constraint/effort/episode", "effort of an episode"),
        ("constraint/arm/torque/episode", "arm/torque of an episode"),
    ],
)
def test_what_a_budget_costs_and_what_is_used_of_it(name, title):
    assert [(panel.metric, panel.title) for panel in budgets([name], DECLARED)] == [(name, title)]


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ([40.0], "above the budget 40 N [%]"),
        ([40.0, 40.0], "above the budget 40 N [%]"),
        ([40.0, None], "above the budget 40 N [%]"),  # the other one has no such share
        ([15.0, 40.0], "above its budget [%]"),
        ([None], "above its budget [%]"),
    ],
)
def test_a_bound_is_named_where_all_that_have_one_have_the_same(bounds, words):
    declared = agreed({"contact_force": {"unit": "N", "budget": bound}} for bound in bounds)
    title = quantity_title("metrics/contact_force_above_budget", declared)
    assert title == f"contact force {words}"


def test_a_quantity_may_be_above_something_by_name():
    (panel,) = quantities(["metrics/height_above_table"], {"height_above_table": {"unit": "m"}})
    assert (panel.title, panel.scale) == ("height above table, mean [m]", 1.0)
