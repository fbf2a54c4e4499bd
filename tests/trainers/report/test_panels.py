"""Titles of panels: a quantity by its name, with its unit."""

import pytest

from rrl.trainers.report.panels import budgets

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
