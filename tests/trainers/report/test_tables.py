"""The tables: right numbers in the right cells, with their intervals."""

import json
from dataclasses import replace

import numpy as np
import pytest

from rrl.trainers.evaluation.episodes import Comparison, Episodes, write_results
from rrl.trainers.metric import Metric
from rrl.trainers.report.notes import notes
from rrl.trainers.report.tables import (
    EPISODE_COLUMNS,
    episode_rows,
    markdown_tables,
    one_run,
    quantity_rows,
    success_rows,
    with_interval,
)


def episodes(successes, n=20, returns=-1.0, force=0.0):
    solved = None if successes is None else np.arange(n) < successes
    metrics = {"contact_force": np.arange(n) + force}
    return Episodes(np.full(n, returns), np.full(n, 5), solved, np.zeros(n, dtype=bool), metrics)


def test_cells_hold_rates_intervals_and_changes():
    comparisons = [Comparison(episodes(k), episodes(2)) for k in (15, 19)]
    (row,) = success_rows({"misaligned": [c.record() for c in comparisons]})
    assert row[:2] == ["misaligned", "10.0 [2.7, 30.2] %"]
    assert row[2].startswith("85.0 [")
    assert row[3].startswith("+75.0 [+")
    assert row[4:] == ["15", "0"]


def test_one_run_has_wilsons_interval_and_never_one_of_zero_width():
    (row,) = success_rows(one_run({"aligned": Comparison(episodes(20), episodes(20))}))
    assert row[1] == row[2] == "100.0 [83.8, 100.0] %"
    assert row[3].startswith("+0.0 [-")


def test_returns_stand_in_where_there_is_no_success():
    compared = Comparison(episodes(None, returns=-1.5), episodes(None, returns=-4.0))
    (row,) = success_rows(one_run({"own": compared}))
    assert row[1:3] == ["-4.00 (no interval)", "-1.50 (no interval)"]
    assert row[3] == "+2.50 (no interval)"


@pytest.mark.parametrize(
    ("interval", "text"),
    [
        ((0.99961, 1.0), "100.0 [99.9, 100.0] %"),
        ((0.98951, 0.99), "100.0 [98.9, 99.0] %"),
        ((0.0, 0.0004), "100.0 [0.0, 0.1] %"),
    ],
)
def test_bounds_are_rounded_outwards(interval, text):
    assert with_interval(1.0, interval, 100.0) == text


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [
        (np.nan, (np.nan, np.nan), "nan"),
        (1.0, (np.nan, np.nan), "1.00 (no interval)"),
        (1.0, (-np.inf, np.inf), "1.00 [-inf, inf]"),
        (0.0, (-0.0, 1.0), "0.00 [0.00, 1.00]"),
    ],
)
def test_what_is_not_finite_is_written_as_it_is(value, interval, text):
    assert with_interval(value, interval) == text


def test_every_reported_quantity_has_mean_and_tail_with_its_unit():
    results = one_run({"one": Comparison(episodes(9, force=5.0), episodes(4))})
    header, rows = quantity_rows(results, {"contact_force": {"unit": "N"}})
    cells = dict(zip(header, rows[0], strict=True))
    assert cells["contact force, mean [N]"] == "9.50 → 14.50"
    assert cells["contact force, 99th percentile [N]"] == "18.81 → 23.81"
    assert cells["return"] == "-1.00 → -1.00"
    assert "contact force, mean [N]" in markdown_tables(results, {"contact_force": {"unit": "N"}})


def test_episodes_above_budget_and_limit_are_counted_and_the_budget_is_judged():
    how = Metric(unit="N", reduce="max", budget=12.0, limit=18.0)

    def forced(force):
        return replace(episodes(9, force=force), declared={"contact_force": how})

    results = one_run(
        {name: Comparison(forced(f), forced(0.0)) for name, f in (("a", 5), ("b", 2))}
    )
    declared = {"contact_force": how.model_dump()}
    header, rows = quantity_rows(results, declared)
    cells = dict(zip(header, rows[0], strict=True))
    assert cells["contact force above the budget 12 N [%]"] == "35.0 → 60.0"
    assert cells["contact force above the limit 18 N [%]"] == "5.0 → 30.0"
    said = "Budget for the mean of contact force, 12 N: a 14.5, not kept; b 11.5, kept."
    assert said in notes(results, declared)
    assert said in markdown_tables(results, declared)


def test_the_budget_is_judged_of_what_is_handed_over_too():
    how = Metric(unit="N", reduce="max", budget=12.0)
    latest, accepted = (
        replace(episodes(9, force=force), declared={"contact_force": how}) for force in (2.0, 5.0)
    )
    compared = Comparison(latest, latest, accepted=accepted, accepted_env_steps=3000)
    results, declared = one_run({"a": compared}), {"contact_force": how.model_dump()}
    said = "12 N: a 11.5, kept; a, handed over, 14.5, not kept."
    assert any(text.endswith(said) for text in notes(results, declared))
    header, rows = quantity_rows(results, declared)
    mean = header.index("contact force, mean [N]")
    assert [row[0] for row in rows] == ["a", "a, handed over"]
    assert [row[mean] for row in rows] == ["11.50 \u2192 11.50", "11.50 \u2192 14.50"]


def test_what_is_not_paired_is_not_called_rescued_or_broken():
    compared = [Comparison(episodes(k), episodes(2), frozen=False) for k in (15, 19)]
    paired = [replace(c, frozen=True) for c in compared]
    (row,), (other,) = (
        success_rows({"drift": [c.record() for c in both]}) for both in (compared, paired)
    )
    assert row[1] == "10.0 [3.9, 23.1] %"  # two runs of 20 episodes each
    assert row[2] == other[2]
    assert row[3].startswith("+75.0 [+")
    assert row[3] != other[3]
    assert row[4:] == ["", ""]
    assert {r[2] for r in episode_rows(one_run({"drift": compared[0]}))} == {None}
    text = markdown_tables(one_run({"drift": compared[0], "still": paired[0]}), {})
    assert "The episodes of drift are not frozen" in text
    assert "not frozen" not in markdown_tables(one_run({"still": paired[0]}), {})


def test_the_policies_handed_over_have_a_row_of_their_own_where_they_are_others():
    latest, controller = episodes(15), episodes(2)
    same = Comparison(latest, controller, accepted=latest, accepted_env_steps=900)
    earlier = replace(same, accepted=episodes(19), accepted_env_steps=300)
    none = replace(same, accepted=controller, accepted_env_steps=0)
    assert len(success_rows(one_run({"drift": same}))) == 1
    rows = success_rows({"drift": [c.record() for c in (same, earlier, none)]})
    assert [row[0] for row in rows] == ["drift", "drift, handed over"]
    assert rows[0][2].startswith("75.0 [")
    assert rows[1][2].startswith("60.0 [")  # 15, 19 and 2 of 20
    assert (rows[1][4], rows[0][4]) == ("10", "13")
    assert notes(one_run({"drift": earlier}), {})[-1].startswith(
        "Handed over: the policy after 300 environment steps"
    )
    assert notes(one_run({"drift": none}), {})[-1].startswith("Handed over: the controller alone.")
    all_three = {"drift": [c.record() for c in (same, earlier, none)]}
    assert "a learned policy by 2 of 3 runs" in notes(all_three, {})[-1]
    assert notes(all_three, {})[-1] in markdown_tables(all_three, {})


def test_every_episode_has_its_outcome():
    rows = episode_rows(one_run({"one": Comparison(episodes(9), episodes(4))}))
    found = [dict(zip(EPISODE_COLUMNS, row, strict=True)) for row in rows]
    assert [r["outcome"] for r in found if r["entry"] == "return"][3:5] == ["both", "rescued"]
    assert {r["entry"] for r in found} == {"return", "success", "metrics/contact_force"}


def test_written_results_hold_summary_and_every_episode(tmp_path):
    write_results({"misaligned": Comparison(episodes(15), episodes(2))}, tmp_path / "results.json")
    content = json.loads((tmp_path / "results.json").read_text())["misaligned"]
    assert content["summary"]["rescues"] == 13
    assert sum(content["episodes"]["success"]) == 15
    assert sum(content["episodes"]["controller_success"]) == 2
    assert len(content["episodes"]["controller_metrics/contact_force"]) == 20


@pytest.mark.parametrize(("unit", "shown"), [(1e-3, "0.0015"), (1.0, "1.50"), (1e6, "1500000.00")])
def test_numbers_of_any_size_can_be_read(unit, shown):
    policy, controller = (
        replace(episodes(None, returns=x * unit), metrics={"error": np.full(20, x * unit)})
        for x in (1.5, 4.0)
    )
    results = one_run({"own": Comparison(policy, controller)})
    (row,), (_, quantities) = success_rows(results), quantity_rows(results, {})
    assert row[2] == f"{shown} (no interval)"
    assert shown in quantities[0][-2]
    assert with_interval(-1.5 * unit, (-2.5 * unit, 0.0)).startswith(f"-{shown} [-")


def test_what_is_rounding_has_no_digits():
    assert with_interval(1e-17, (-1e-17, 1e-16), sign="+") == "+0.00 [+0.00, +0.00]"
