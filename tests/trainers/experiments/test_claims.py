"""Claims are judged by the numbers, whichever way they fall; what has no numbers is not judged."""

import csv
import json

import numpy as np
import pytest
import yaml

from browser import needs_chromium, opened
from rrl.trainers.experiments.claims import CLAIMS, judge
from rrl.trainers.experiments.figures import draw
from rrl.trainers.experiments.outcomes import Finding, Outcome
from rrl.trainers.experiments.plan import Point
from rrl.trainers.experiments.report import Shown, write_report, write_results
from rrl.trainers.experiments.spec import Experiment, Settings
from rrl.trainers.experiments.tables import final_rows, success_rows
from rrl.trainers.launch.job import Job
from rrl.trainers.launch.pool import Ending
from rrl.trainers.report.runs import Run

SEEDS = (0, 1, 2)
EPISODES = 20


@pytest.fixture
def outcome(tmp_path):
    """Makes an outcome from final numbers by entry and curves by entry, spread a little over the seeds."""

    def make(
        arm="residual RL", value=None, curves=None, scenario="misaligned", scenarios=None, **final
    ):
        scenarios = scenarios or {scenario: {}}
        runs = tuple(write(arm, curves, scenarios, final, seed) for seed in SEEDS)
        point = Point("some", arm, value, "key", (), runs[0].config, SEEDS)
        return Outcome(point, runs)

    def write(arm, curves, scenarios, final, seed):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        path.mkdir()
        numbers = {"success": 1.0, "return": -2.0, "controller_success": 0.1}
        numbers |= {"controller_return": -4.0, **final}
        numbers = {"return_gain": numbers["return"] - numbers["controller_return"], **numbers}
        numbers = {"rescues": 5, "regressions": 0, "mcnemar_p": 0.06, **numbers}
        numbers["return"] += 0.001 * seed
        results = {
            name: {"summary": {**numbers, **entry}, "episodes": {"return": [0.0] * EPISODES}}
            for name, entry in scenarios.items()
        }
        (path / "results.json").write_text(json.dumps(results))
        curves = {"success": [0, 1], "return": [-4, -2], **(curves or {})}
        curves |= {f"controller_{name}": [v[0]] * len(v) for name, v in curves.items()}
        with (path / "metrics.csv").open("w") as file:
            rows = csv.writer(file)
            rows.writerow(["env_steps", "metric", "value"])
            followed = f"eval/{next(iter(results))}"
            for name, values in curves.items():
                spread = 0.0 if name.endswith("success") else 0.01 * seed
                rows.writerows(
                    [i * 500, f"{followed}/{name}", v + spread] for i, v in enumerate(values)
                )
        trainer = {"seed": seed, "num_seeds": 1, "total_steps": 500}
        trainer["evaluation"] = {"episodes": EPISODES, "final_episodes": EPISODES}
        config = {"trainer": trainer, "env": {"scenarios": {name: {} for name in results}}}
        config["controller"] = {"_target_": "rrl.controllers.ProportionalController"}
        (path / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
        return Run(path, path.name)

    return make


def verdict(number, *outcomes):
    claim = next(claim for claim in CLAIMS if claim.number == number)
    found = judge({claim.experiment: Finding(claim.experiment, outcomes)})
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


def test_what_is_not_paired_has_fishers_test(outcome):
    changes = {"rescues": 5, "regressions": 0, "mcnemar_p": 0.06}
    loose = {"success": 0.75, "controller_success": 0.1, "fisher_p": 0.03}
    found = outcome(scenarios={"misaligned": loose})
    for run in found.runs:
        for entry in changes:
            del run.results["misaligned"]["summary"][entry]
    experiment = Experiment(name="one", title="", paper="", figure="table", arms={"a": ()})
    header, (row,) = success_rows(experiment, Finding("one", (found,)))
    cells = dict(zip(header, row, strict=True))
    assert cells["rescued / broken"] == "not paired"
    assert cells["McNemar's p, by seed"].endswith("(Fisher's)")
    assert "0.03" in cells["McNemar's p, by seed"]


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


def test_every_claim_says_how_it_is_tested():
    assert len(CLAIMS) == 13
    for claim in CLAIMS:
        assert len(claim.criterion) > 20
        assert claim.paper


@pytest.mark.parametrize("figure", ["curves", "sweep", "table"])
def test_figures_and_tables_of_a_store(outcome, figure, tmp_path):
    sweep = {"key": "a.b", "label": "b [m]", "values": {"quick": [0.0, 1.0]}}
    experiment = Experiment(
        name="some", title="T", paper="P", figure=figure, arms={"residual RL": ()}, sweep=sweep
    )
    finding = Finding("some", (outcome(value=0.0), outcome(value=1.0, success=0.5)))
    out = draw(experiment, finding, tmp_path / "figures")
    assert out.read_bytes().startswith(b"\x89PNG")
    assert "<svg" in out.with_suffix(".svg").read_text()
    header, rows = final_rows(experiment, finding)
    assert [len(row) for row in rows] == [len(header)] * 2
    assert rows[1][:3] == ["residual RL", "1", "3"]
    header, rows = success_rows(experiment, finding)
    assert rows[1][2] == "1"
    assert rows[1][3].startswith("10/10/10 of 20 [")
    assert rows[1][4] == "10.0"


def shown_of(outcome, tmp_path):
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
    findings = {e.name: Finding(e.name, (made,)) for e in experiments}
    figures = {e.name: draw(e, findings[e.name], tmp_path / "figures") for e in experiments}
    scale = {"quick": {"seeds": 3}}
    settings = Settings(scale="quick", launcher="local", workers=1, out="out", scales=scale)
    return Shown(experiments, findings, figures, judge(findings), settings)


def test_the_results_are_a_page_for_a_repository(outcome, tmp_path):
    shown = shown_of(outcome, tmp_path)
    page = write_results(shown, tmp_path / "results.md").read_text()
    for expected in (
        "| 6a. Misaligned: about 15 of 20, by the controller about 2 | 15 of 20, controller 2",
        "| 6b. Aligned: 20 of 20, and so by the controller |",
        "## Table (P)",
        "![Experiment `success-real`](figures/success-real.png)",
        "| misaligned | residual RL | 20/20/20 of 20 [",
        "Seeds of every arm: 3.",
        "`rrl reproduce table scale=quick`",
    ):
        assert expected in page, expected
    assert str(tmp_path) not in page  # it can be put into any repository
    for line in page.splitlines():
        if line.startswith("!["):
            assert (tmp_path / line.rpartition("(")[2].rstrip(")")).is_file()


@needs_chromium
def test_the_report_opens_offline_and_without_errors(outcome, tmp_path):
    failed = Job(tmp_path / "lost/seed-0", {"trainer": {"total_steps": 100}})
    ending, shown = Ending(failed=[failed]), shown_of(outcome, tmp_path)
    path = write_report(shown, None, {}, ending, tmp_path / "r.html")
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
