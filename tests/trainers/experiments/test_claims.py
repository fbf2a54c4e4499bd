"""Claims are judged by the numbers, whichever way they fall; what has no numbers is not judged."""

from dataclasses import replace

import numpy as np
import pytest

from browser import needs_chromium, opened
from experiment_project import finding
from rrl.trainers.experiments.claims import CLAIMS, judge
from rrl.trainers.experiments.figures import draw
from rrl.trainers.experiments.outcomes import Finding
from rrl.trainers.experiments.report import Shown, write_experiments, write_results
from rrl.trainers.experiments.spec import Experiment, Settings
from rrl.trainers.launch.job import Job
from rrl.trainers.launch.pool import Ending


def verdict(number, *outcomes):
    claim = next(claim for claim in CLAIMS if claim.number == number)
    found = judge({claim.experiment: finding(*outcomes)})
    return next(verdict for verdict in found if verdict.claim is claim)


def test_learning_faster_is_more_return_over_all_evaluations(outcome):
    residual, slow = (
        outcome(curves={"return": [-4, -2, -2]}),
        outcome("RL alone", curves={"return": [-9, -6, -2]}),
    )
    assert verdict("1a", residual, slow).word == "holds"
    as_fast = outcome("RL alone", curves={"return": [-4, -2, -2]})
    assert verdict("2a", residual, as_fast).word == "does not hold"


def test_ending_above_the_controller_is_a_gain_that_is_surely_positive(outcome):
    assert verdict("1b", outcome(**{"return": -2.0})).holds
    assert not verdict("2b", outcome(**{"return": -4.2})).holds


@pytest.mark.parametrize(
    ("last", "controller", "holds"), [(-2.2, -4.0, True), (-3.5, -4.0, False), (-2.0, -2.0, False)]
)
def test_level_is_losing_a_third_of_what_the_controller_loses(outcome, last, controller, holds):
    first = outcome(value=0.0, controller_return=-2.0)
    end = outcome(value=0.3, controller_return=controller, **{"return": last})
    assert verdict("3", end, first).holds == holds
    assert verdict("5", first, end).holds == holds


@pytest.mark.parametrize("number", ["3", "4", "5"])
def test_a_claim_about_what_is_no_number_is_not_tested(outcome, number):
    both = outcome(value=0.0), outcome(value=0.3, **{"return": np.nan})
    assert verdict(number, *both).word == "not tested"


def test_a_mean_that_rounding_leaves_just_below_a_bound_reaches_it(outcome):
    arm = "residual RL on the policy from simulation"
    quick = outcome(arm, curves={"success": [0.2, 0.9]})
    rates = (0.85, 0.95)
    assert np.mean(rates) < 0.9
    for run, rate in zip(quick.runs, rates, strict=False):
        points = next(v for name, v in run.metrics.items() if name.endswith("/success"))
        points[-1] = (points[-1][0], rate)
    point = replace(quick.point, seeds=quick.point.seeds[:2])
    assert verdict("9", replace(quick, point=point, runs=quick.runs[:2])).holds


def test_the_papers_table(outcome):
    scenarios = {
        "misaligned": {"success": 0.75, "controller_success": 0.1},
        "aligned": {"success": 1.0, "controller_success": 1.0},
    }
    found = outcome(scenarios=scenarios)
    assert verdict("6a", found).holds
    numbers = verdict("6a", found).numbers
    assert "residual 15/15/15 of 20 [" in numbers
    assert "15.0 of 20; controller 2 of 20 [" in numbers
    assert verdict("6b", found).holds
    scenarios["misaligned"]["success"] = 0.7
    scenarios["aligned"]["success"] = 0.9
    assert not verdict("6a", outcome(scenarios=scenarios)).holds
    assert not verdict("6b", outcome(scenarios=scenarios)).holds


def test_success_grows(outcome):
    assert verdict("7", outcome(curves={"success": [0.1, 0.5, 0.8]})).holds
    assert not verdict("7", outcome(curves={"success": [0.1, 0.5, 0.6]})).holds


def test_bias_does_not_stop_learning_if_every_bias_is_learned(outcome):
    good, bad = outcome(value=0.1), outcome(value=0.2, success=0.5)
    assert verdict("8", good).holds
    assert not verdict("8", good, bad).holds


def test_transfer_is_quick_if_success_stays_from_before_a_thousand_steps_on(outcome):
    arm = "residual RL on the policy from simulation"
    quick, late = (
        outcome(arm, curves={"success": [0.2, 0.95]}),
        outcome(arm, curves={"success": [0.2, 0.3, 0.95]}),
    )
    assert verdict("9", quick).holds
    assert not verdict("9", late).holds
    assert not verdict(
        "9", outcome(arm, curves={"success": [0.95, 0.3, 0.95]})
    ).holds  # it was lost again
    assert (
        "RL from scratch: not reached (from 0%)"
        in verdict("9", quick, outcome("RL from scratch", curves={"success": [0, 0]})).numbers
    )


def test_a_claim_without_its_outcomes_is_not_tested(outcome):
    assert verdict("1a", outcome()).word == "not tested"
    assert verdict("3", outcome(value=0.0)).word == "not tested"
    assert judge({}) == []


def test_a_claim_is_not_judged_on_a_part_of_its_runs(outcome):
    whole, part = outcome(), outcome("RL alone")
    found = verdict("1a", whole, replace(part, runs=part.runs[:2]))
    assert (found.word, found.numbers) == (
        "not tested",
        'finished so far: 2 of 3 seeds of "RL alone"',
    )
    claim = next(claim for claim in CLAIMS if claim.number == "8")
    planned = (outcome(value=0.1).point, outcome(value=0.2).point)
    (found,) = judge({claim.experiment: Finding((outcome(value=0.1),), planned)})
    assert '0 of 3 seeds of "residual RL, mu = 0.2"' in found.numbers


def test_one_seed_says_nothing_of_an_interval_over_seeds(outcome):
    arms = [outcome(), outcome("RL alone")]
    alone = [replace(o, runs=o.runs[:1], point=replace(o.point, seeds=(0,))) for o in arms]
    found = verdict("1a", *alone)
    assert found.word == "not tested"
    assert "at least two seeds" in found.numbers
    assert verdict("6a", *alone).holds  # it asks for no interval


def test_every_claim_says_how_it_is_tested():
    assert len(CLAIMS) == 13
    for claim in CLAIMS:
        assert len(claim.criterion) > 20
        assert claim.paper


def shown_of(outcome, tmp_path, **ending):
    """Two experiments of one outcome with two scenarios."""
    experiments = [
        Experiment(
            name="table", title="Table", paper="P", figure="table", arms={"residual RL": ()}
        ),
        Experiment(
            name="success-real",
            title="Curves",
            paper="P",
            figure="curves",
            arms={"residual RL": ()},
        ),
    ]
    made = outcome(scenarios={"misaligned": {}, "aligned": {"success": 0.5}})
    findings = {e.name: finding(made) for e in experiments}
    figures = {e.name: draw(e, findings[e.name], tmp_path / "figures") for e in experiments}
    scale = {"quick": {"seeds": 3}}
    settings = Settings(scale="quick", launcher="local", workers=1, out="out", scales=scale)
    return Shown(experiments, findings, figures, judge(findings), settings, Ending(**ending))


def test_the_results_are_a_page_for_a_repository(outcome, tmp_path):
    failed, blocked = (Job(tmp_path / f"{name}/seed-0", {}) for name in ("lost", "left"))
    shown = shown_of(outcome, tmp_path, failed=[failed], blocked=[blocked])
    page = write_results(shown, tmp_path / "results.md").read_text()
    for expected in (
        "| 6a. Misaligned: about 15 of 20, by the controller about 2 | 15 of 20, controller 2",
        "| 6b. Aligned: 20 of 20, and so by the controller |",
        "## Table (P)",
        "![Experiment `success-real`](figures/success-real.png)",
        "| misaligned | residual RL | 20/20/20 of 20 [",
        "Seeds of every arm: 3.",
        "`rrl reproduce table scale=quick`",
        "Failed: `lost/seed-0`.",
        "Not started, as they need one that failed: `left/seed-0`.",
    ):
        assert expected in page, expected
    assert str(tmp_path) not in page  # it can be put into any repository
    for line in page.splitlines():
        if line.startswith("!["):
            assert (tmp_path / line.rpartition("(")[2].rstrip(")")).is_file()


def test_an_experiment_without_a_finished_run_is_named(outcome, tmp_path):
    shown = replace(shown_of(outcome, tmp_path), findings={}, verdicts=[])
    page = write_experiments(shown, None, {}, tmp_path / "r.html").read_text()
    assert "Scale <code>quick</code>, seeds: 3" in page
    assert page.count("No run is finished yet.") == 2


@needs_chromium
def test_the_report_opens_offline_and_without_errors(outcome, tmp_path):
    failed = Job(tmp_path / "lost/seed-0", {"trainer": {"total_steps": 100}})
    shown = shown_of(outcome, tmp_path, failed=[failed])
    path = write_experiments(shown, None, {}, tmp_path / "r.html")
    with opened(path) as page:
        text = page.inner_text("body")
        for expected in (
            "6b. Aligned",
            "does not hold",
            "10/10/10 of 20",
            "lost/seed-0",
            "rrl train trainer.seed=0",
            "torch",
        ):
            assert expected in page.content() or expected in text, expected
        assert page.evaluate("[...document.images].every(image => image.naturalWidth > 0)")


def test_an_outcome_puts_the_seeds_together(outcome):
    together = outcome()
    assert [run.seed for run in together.runs] == [0, 1, 2]
    np.testing.assert_allclose(together.final("return"), [-2.0, -1.999, -1.998])
    assert together.curve("success").values.shape == (3, 2)
