"""How an arm stands: by what its runs hand over, at every evaluation and at the end."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from experiment_project import finding, write
from rrl.trainers.experiments.against_controller import HEADER, Standing, standing, standing_row
from rrl.trainers.experiments.outcomes import Outcome
from rrl.trainers.experiments.plan import Point
from rrl.trainers.experiments.tables import effort
from rrl.trainers.report.runs import Run

EPISODES = 20
CONFIG = {
    "env": {"scenarios": {"task": {}}, "packages": ["metaworld"]},
    "controller": {"_target_": "rrl.controllers.FunctionController"},
}
TRAINER = {"evaluation": {"episodes": EPISODES}, "acceptance": {"margin": 0.05}}


@pytest.fixture
def outcome(tmp_path):
    """An arm of two runs, three seeds asked for; the controller solves half of the episodes.

    ``handed_over`` and ``latest`` are what the policies solve at the end, ``least`` what was handed
    over at the worse of two evaluations during training; all of 20.
    """

    def make(handed_over, least=10, latest=0, arm="push", entry="success"):
        runs = tuple(run(seed, handed_over, least, latest, entry) for seed in range(2))
        config = {**CONFIG, "trainer": TRAINER}
        return Outcome(Point("some", arm, None, "key", (), config, (0, 1, 2)), runs)

    def run(seed, handed_over, least, latest, entry):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        path.mkdir()
        (path / "config.yaml").write_text(
            yaml.safe_dump({**CONFIG, "trainer": {**TRAINER, "seed": seed}})
        )
        solved = {"controller_": 10, "": latest, "accepted_": handed_over}
        episodes = {p + entry: [float(i < n) for i in range(EPISODES)] for p, n in solved.items()}
        summary = {f"{p}{entry}": n / EPISODES for p, n in solved.items()}
        summary |= {f"{p}{change}": 0 for p in solved for change in ("rescues", "regressions")}
        results = {"task": {"summary": summary, "episodes": episodes}}
        (path / "results.json").write_text(json.dumps(results))
        (path / "versions.json").write_text(json.dumps({"metaworld": "3.0.0"}))
        during = {"controller_": [10, 10], "": [0, 0], "accepted_": [10, least]}
        with (path / "metrics.csv").open("w") as file:
            rows = csv.writer(file)
            rows.writerow(["env_steps", "metric", "value"])
            for prefix, values in during.items():
                name = f"eval/task/{prefix}{entry}"
                rows.writerows([i * 500, name, n / EPISODES] for i, n in enumerate(values))
            rows.writerow([500, "time/collect", 90.0])
        return Run(path, path.name)

    return make


@pytest.mark.parametrize(
    ("handed_over", "least", "word"),
    [(20, 10, "better"), (10, 10, "not worse"), (11, 10, "not worse"), (20, 8, "worse")],
)
def test_what_is_handed_over_is_judged_at_the_end_and_on_the_way(outcome, handed_over, least, word):
    found = standing(outcome(handed_over, least))
    assert found.verdict == word
    assert found.gain == pytest.approx((handed_over - 10) / EPISODES)
    assert found.least == pytest.approx((least - 10) / EPISODES)
    assert found.margin == 0.05


@pytest.mark.parametrize("episodes", [20, 40, 60, 80, 100])
def test_what_is_exactly_the_margin_below_the_controller_is_not_worse(episodes):
    for solved in range(episodes // 20, episodes + 1):
        for below, word in ((episodes // 20, "not worse"), (episodes // 20 + 1, "worse")):
            change = (solved - below) / episodes - solved / episodes
            assert Standing("success", 0.05, change, (-1.0, 0.0), change).verdict == word


def test_without_success_the_margin_is_a_share_of_the_range_of_returns(outcome):
    found = standing(outcome(20, entry="return"))
    assert found.entry == "return"
    assert found.margin == pytest.approx(0.05 * 1.0)  # the controller's returns are 0 and 1
    assert found.verdict == "better"
    made = outcome(20, entry="return")
    for run in made.runs:  # a start without chance: the size of the return stands in, as in a test
        run.results["task"]["episodes"]["controller_return"] = [-50.0] * EPISODES
    assert standing(made).margin == pytest.approx(0.05 * 50.0)


@pytest.mark.parametrize("where", ["episodes", "metrics"])
def test_a_return_that_is_no_number_is_no_verdict(outcome, where):
    made = outcome(20, entry="return")
    run = made.runs[0]
    values = run.results["task"]["episodes"] if where == "episodes" else run.metrics
    for name in [name for name in values if name.endswith("accepted_return")]:
        values[name][0] = np.nan if where == "episodes" else (0, np.nan)
    assert standing(made).verdict == "unknown"
    assert "unknown" in standing_row(made)


def test_a_row_has_every_number_with_its_interval_and_the_packages(outcome):
    row = dict(zip(HEADER, standing_row(outcome(20, latest=3)), strict=True))
    assert row["task"] == "push"
    assert row["controller"].startswith("50.0 [")
    assert row["latest policy"].startswith("15.0 [")
    assert row["handed over"].startswith("100.0 [")
    assert row["gain of what is handed over"].startswith("+50.0 [+")
    assert row["least gain at an evaluation"] == "+0.00 (allowed: -5.00)"
    assert row["wall time of a run"] == "1.5 min"
    assert row["packages"] == "metaworld 3.0.0"


def test_small_rewards_are_no_zeros(outcome):
    made = outcome(20, least=8, entry="return")
    for seed, run in enumerate(made.runs):
        for name, values in run.results["task"]["episodes"].items():
            seen = [1e-3 * value + 1e-5 * seed for value in values]
            run.results["task"]["episodes"][name] = seen
        for name, points in run.metrics.items():
            run.metrics[name] = [(step, 1e-3 * value) for step, value in points]
    row = dict(zip(HEADER, standing_row(made), strict=True))
    assert row["handed over"].startswith("0.0010 [")
    assert row["least gain at an evaluation"] == "-0.00010 (allowed: -0.00005)"


def test_it_is_said_which_seeds_are_missing_and_what_the_runs_took(outcome):
    found = finding(outcome(20), outcome(10, arm="hammer"))
    said = effort(found)
    assert "Finished so far: 2 of 3 seeds of every arm." in said
    assert "Wall time of all 4 runs together, one after the other: 0.1 h" in said
    nothing = replace(found, outcomes=found.outcomes[:1])
    assert 'so far: 0 of 3 seeds of "hammer"; 2 of 3 seeds of "push".' in effort(nothing)
    assert "Seeds of every arm: 2." in effort(finding(whole(found.outcomes[0])))


def whole(outcome):
    point = Point("some", "push", None, "key", (), outcome.point.config, (0, 1))
    return Outcome(point, outcome.runs)


@pytest.mark.slow
def test_the_command_writes_page_figure_and_table(project, run):
    arms = {"drifting": [], "still": ["env.base.drift=0.0"]}
    overrides = ["trainer.acceptance.enabled=true", "+env.packages=[numpy]"]
    content = {"title": "Points", "figure": "tasks", "seeds": 1, "overrides": overrides}
    write(project / "configs/experiment/points.yaml", {**content, "arms": arms})
    report, said = run("points")
    page = (report.parent / "results-points.md").read_text()
    for arm in arms:
        assert f"| {arm} | success |" in page
        assert arm in said
        assert arm in report.read_text()
    assert page.startswith("# Points\n")
    assert "![Experiment `points`](figures/points.png)" in page
    assert "numpy" in page
    assert (report.parent / "figures/points.png").stat().st_size > 5000
