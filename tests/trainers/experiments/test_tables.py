"""Tables of results: how arms are compared with their controller, and what a single seed says."""

import csv
from dataclasses import replace

import numpy as np

from experiment_project import ZERO, finding, of
from rrl.trainers.experiments.numbers import write_numbers
from rrl.trainers.experiments.outcomes import Counts
from rrl.trainers.experiments.tables import final_rows, followed_rows, outcome_rows, steps_rows


def unpair(run, scenario):
    """The summary of a run whose episodes were found not to be frozen."""
    summary = run.results[scenario]["summary"]
    for entry in ("rescues", "regressions", "mcnemar_p"):
        del summary[entry]
    return summary


def test_what_is_not_paired_has_fishers_test(outcome):
    loose = {"success": 0.75, "controller_success": 0.1, "fisher_p": 0.03}
    found = outcome(scenarios={"misaligned": loose})
    for run in found.runs:
        unpair(run, "misaligned")
    header, (row,) = outcome_rows(of("table"), finding(found))
    cells = dict(zip(header, row, strict=True))
    assert cells["rescued / broken"] == "not paired"
    assert cells["McNemar's p, by seed"].endswith("(Fisher's)")
    assert "0.03" in cells["McNemar's p, by seed"]


def test_scenarios_may_be_paired_or_not(outcome):
    made = outcome(scenarios={"frozen": {}, "loose": {"fisher_p": 0.03}})
    for run in made.runs:
        unpair(run, "loose")
    _, rows = outcome_rows(of("table"), finding(made))
    assert [row[-2] for row in rows] == ["15 / 0", "not paired"]


def test_seeds_that_found_the_episodes_frozen_stand_beside_others(outcome):
    made = outcome(scenarios={"misaligned": {"success": 0.75, "controller_success": 0.1}})
    loose = unpair(made.runs[0], "misaligned")
    loose |= {"fisher_p": 0.03, "controller_success": 0.2}
    episodes = made.runs[0].results["misaligned"]["episodes"]
    episodes["controller_success"] = [i < 4 for i in range(20)]
    header, (row,) = outcome_rows(of("table"), finding(made))
    cells = dict(zip(header, row, strict=True))
    assert cells["rescued / broken"] == "not paired"
    assert cells["controller"].startswith("4/2/2 of 20")
    assert cells["McNemar's p, by seed"].count("Fisher's") == 1


def test_an_arm_that_acts_alone_is_compared_with_no_controller(outcome, tmp_path):
    alone, helped = outcome("RL alone"), outcome("residual RL")
    alone.point.config["controller"] = ZERO
    _, rows = outcome_rows(of("table"), finding(alone, helped))
    assert rows[0][4:] == ["none", "", "", ""]
    assert rows[1][4].startswith("2 of 20")
    path = write_numbers(of("table"), finding(alone, helped), tmp_path / "numbers.csv")
    with path.open(newline="") as file:
        numbers = [row for row in csv.DictReader(file) if row["evaluation"] == "final"]
    assert [row["arm"] for row in numbers if row["rescues"]] == ["residual RL"] * 3
    assert [row["arm"] for row in numbers if row["controller_return"]] == ["residual RL"] * 3
    assert all(row["latest_success"] for row in numbers)


def test_rows_of_a_sweep_name_the_setting(outcome):
    experiment = of("sweep", evaluated_at=(500,))
    found = finding(outcome(value=0.0), outcome(value=1.0))
    for rows in (steps_rows, followed_rows):
        header, (first, second) = rows(experiment, found)
        assert header[:2] == ["arm", "mu"]
        assert (first[1], second[1]) == ("0", "1")
        assert len(first) == len(header)


def test_success_of_runs_that_all_succeed_is_not_certain(outcome):
    """Its interquartile mean would have an interval of zero width."""
    header, (row,) = final_rows(of("table"), finding(outcome(success=1.0)))
    shown = [cell for title, cell in zip(header, row, strict=True) if title.startswith("success")]
    assert shown == ["100.0 [74.7, 100.0] %"]
    assert str(Counts(np.ones((1, 1000), dtype=bool))).endswith("[99%, 100%]")


def test_one_seed_has_no_interval(outcome):
    made = outcome()
    experiment, found = of("table"), finding(replace(made, runs=made.runs[:1]))
    _, (row,) = final_rows(experiment, found)
    assert row[2] == "-2.00 (no interval)"
    assert not any("nan" in cell for cell in row)
