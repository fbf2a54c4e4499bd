"""Figures and the pages around them show every arm, and whose controller is whose."""

from dataclasses import replace

import imageio.v3 as iio
import numpy as np
import pytest
from matplotlib.container import Container
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiment_project import SPREAD, ZERO, finding, of
from rrl.trainers.experiments.figures import draw
from rrl.trainers.experiments.front import front_rows
from rrl.trainers.experiments.report import Shown, write_results
from rrl.trainers.experiments.spec import Experiment, Scale, Settings, Spread
from rrl.trainers.experiments.tables import final_rows, followed_rows, outcome_rows, steps_rows
from rrl.trainers.launch.pool import Ending


def labels(figure, found, folder, **changes):
    """The figure as SVG, which has its words in comments."""
    return draw(of(figure, **changes), found, folder).with_suffix(".svg").read_text()


def page(experiment, found):
    """The page for a repository, below its introduction."""
    folder = found.outcomes[0].runs[0].path
    figures = {experiment.name: folder / f"figures/{experiment.name}.png"}
    scales = {"quick": Scale(seeds=3)}
    settings = Settings(scale="quick", launcher="local", workers=0, out="out", scales=scales)
    shown = Shown([experiment], {experiment.name: found}, figures, [], settings, Ending())
    return write_results(shown, folder / "results.md").read_text().partition("\n\n![")[2]


def without_success(outcome):
    for run in outcome.runs:
        for name in [name for name in run.metrics if name.endswith("success")]:
            del run.metrics[name]
        for record in run.results.values():
            for entry in ("success", "controller_success"):
                del record["summary"][entry]
    return outcome


@pytest.mark.parametrize("figure", ["curves", "sweep", "table"])
def test_figures_and_tables_of_a_store(outcome, figure, tmp_path):
    sweep = {"key": "a.b", "label": "b [m]", "values": {"quick": [0.0, 1.0]}}
    experiment = Experiment(
        name="some", title="T", paper="P", figure=figure, arms={"residual RL": ()}, sweep=sweep
    )
    found = finding(outcome(value=0.0), outcome(value=1.0, success=0.5))
    out = draw(experiment, found, tmp_path / "figures")
    assert out.read_bytes().startswith(b"\x89PNG")
    assert "<svg" in out.with_suffix(".svg").read_text()
    header, rows = final_rows(experiment, found)
    assert [len(row) for row in rows] == [len(header)] * 2
    assert rows[1][:3] == ["residual RL", "1", "3"]
    header, rows = outcome_rows(experiment, found)
    assert rows[1][2] == "1"
    assert rows[1][3].startswith("10/10/10 of 20 [")
    assert rows[1][4] == "10.0"


def moving(outcome):
    """The same arm with the variance of its positions."""
    for run in outcome.runs:
        (run.path / "positions.json").write_text("[1.0, 2.0, 3.0]")
    return outcome


@pytest.mark.parametrize("figure", ["curves", "table"])
@pytest.mark.parametrize(
    ("counts", "said"), [([1], "1 seed, "), ([3], "3 seeds, "), ([1, 3], "1 to 3 seeds, ")]
)
def test_the_title_says_how_many_seeds_there_are(outcome, figure, counts, said, tmp_path):
    made = [outcome(arm=str(count)) for count in counts]
    some = [replace(o, runs=o.runs[:n]) for o, n in zip(made, counts, strict=True)]
    assert said in labels(figure, finding(*some), tmp_path)


@pytest.mark.parametrize("silent_first", [True, False])
def test_no_arm_is_said_to_fail_whose_task_reports_no_success(outcome, silent_first):
    silent, telling = without_success(outcome("silent")), outcome("telling")
    found = finding(*((silent, telling) if silent_first else (telling, silent)))
    experiment = of("curves", evaluated_at=(500,))
    for rows in (steps_rows, followed_rows, outcome_rows):
        assert [row[rows is outcome_rows] for row in rows(experiment, found)[1]] == ["telling"]
    text = page(experiment, found)
    assert text.count("| telling |") == 3
    assert text.count("| silent |") == 1  # its return


def test_an_experiment_may_be_called_by_several_words(outcome):
    experiment = of("table").model_copy(update={"name": "two (or more) arms"})
    text = page(experiment, finding(outcome()))
    assert "](figures/two%20%28or%20more%29%20arms.png)" in text
    assert "`rrl reproduce 'two (or more) arms' scale=quick`" in text


@pytest.mark.parametrize("figure", ["curves", "tasks", "table"])
def test_names_are_text_and_no_formulas(outcome, figure, tmp_path):
    found = finding(outcome("for 5 $ (one hour)"), outcome("for 5 $, then for {10 $"))
    assert "<svg" in labels(figure, found, tmp_path)


@pytest.mark.parametrize("figure", ["table", "curves"])
def test_a_page_without_success_has_returns(outcome, figure, tmp_path):
    found = finding(without_success(outcome("silent")))
    assert "<!-- silent" in labels(figure, found, tmp_path)
    text = page(of(figure, evaluated_at=(500,)), found)
    assert "success:" not in text
    assert [line[:10] for line in text.splitlines() if line.startswith("|")] == [
        "| arm | se",
        "| --- | --",
        "| silent |",
    ]


@pytest.mark.parametrize("figure", ["curves", "sweep"])
@pytest.mark.parametrize("others", [0, 1])
def test_return_stands_in_where_no_success_is_reported(outcome, figure, others, tmp_path):
    silent = [without_success(outcome("silent", value=v)) for v in (0.0, 1.0)]
    telling = [outcome("telling", value=v) for v in (0.0, 1.0)][: 2 * others]
    svg = labels(figure, finding(*silent, *telling), tmp_path)
    assert "return of an episode" in svg
    assert ("success rate" in svg) == bool(others)
    assert "<!-- silent" in svg
    assert ("<!-- telling" in svg) == bool(others)


@pytest.mark.parametrize("figure", ["curves", "sweep", "spread", "front"])
def test_arms_look_different_though_there_are_more_than_colors(
    outcome, figure, tmp_path, monkeypatch
):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: drawn.append(self))
    arms = [moving(pressing(outcome, f"arm {i}", 2.0, mu=0.0)) for i in range(9)]
    found = finding(*(replace(arm, runs=arm.runs[:1]) for arm in arms))
    draw(of(figure, metric="force" if figure == "front" else None), found, tmp_path)
    handles, names = drawn[0].axes[0].get_legend_handles_labels()
    looks = {look(h) for h, name in zip(handles, names, strict=True) if name.startswith("arm")}
    assert len(looks) == 9


@pytest.mark.parametrize("figure", ["curves", "tasks"])
def test_a_wide_band_of_few_runs_does_not_flatten_the_lines(outcome, figure, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: drawn.append(self))
    made = without_success(outcome())
    made.runs[0].metrics["eval/misaligned/return"] = [(0, -90.0), (500, 0.0)]
    draw(of(figure), finding(made), tmp_path)
    low, high = drawn[0].axes[0].get_ylim()
    assert -50 < low < -30
    assert 0 < high < 20


def look(handle):
    """What tells a line, a mark or a bar of a legend from others."""
    part = handle[0] if isinstance(handle, Container) else handle
    if isinstance(part, Line2D):
        return part.get_color(), part.get_marker(), part.get_linestyle()
    return part.get_facecolor(), part.get_hatch()


@pytest.mark.parametrize(
    ("figure", "arms"), [("curves", 1), ("spread", 12), ("tasks", 1), ("table", 1)]
)
def test_nothing_that_is_written_is_cut_off(outcome, figure, arms, tmp_path):
    name = "an arm whose name is as long as a line, because it says whatever was set to make it"
    many = (moving(outcome(f"{name}, {i}", mcnemar_p=1e-12)) for i in range(arms))
    found = finding(*(replace(arm, runs=4 * arm.runs) for arm in many))
    picture = iio.imread(draw(of(figure), found, tmp_path))
    edges = [picture[[0, -1]], picture[:, [0, -1]]]
    assert all((edge == 255).all() for edge in edges)


def test_a_plane_has_two_axes(outcome, tmp_path):
    plane = Spread(**SPREAD | {"name": "place", "axes": ["x", "y"]})
    arm = outcome("arm", value=0.0)
    for run in arm.runs:
        (run.path / "places.json").write_text("[1.0, 2.0]")
    arm = replace(arm, point=replace(arm.point, spread=plane))
    svg = labels("spread", finding(arm), tmp_path, spread=plane)
    assert [f"<!-- {name} -->" in svg for name in ("x", "y", "z", "sum")] == [1, 1, 0, 1]


def test_a_sweep_shows_whose_controller_is_whose(outcome, tmp_path):
    alone = outcome("RL alone", value=0.0)
    alone.point.config["controller"] = ZERO
    same = [outcome(arm, value=0.0) for arm in ("first", "second", "third")]
    other = outcome("with limits", value=0.0, controller_return=-9.0)
    assert "controller alone" not in labels("sweep", finding(alone), tmp_path)
    svg = labels("sweep", finding(alone, *same), tmp_path)
    assert "<!-- controller alone -->" in svg
    svg = labels("sweep", finding(*same, other), tmp_path)
    assert "<!-- controller alone -->" in svg
    assert "<!-- controller alone, with limits -->" in svg


def pressing(outcome, arm, force, limit=5.0, mu=None):
    """An arm whose controller presses with some force."""
    entries = {"metrics/force": 3.0, "metrics/force_p99": 4.0, "metrics/force_above_limit": 0.0}
    alone = {f"controller_{name}": force for name in entries}
    made = outcome(arm, mu, **entries, **alone)
    made.point.config["env"]["metrics"] = {"force": {"unit": "N", "limit": limit}}
    return made


def test_a_front_shows_whose_controller_is_whose(outcome, tmp_path):
    arms = [pressing(outcome, arm, 2.0) for arm in ("free", "free too")]
    arms += [pressing(outcome, "slow", 1.0), pressing(outcome, "RL alone", 0.0)]
    arms[-1].point.config["controller"] = ZERO
    experiment, found = of("front", metric="force"), finding(*arms)
    header, rows = front_rows(experiment, found)
    shown = [row[1:5:3] for row in rows if row[1].startswith("controller")]
    assert shown == [["controller alone", "2.0"], ["controller alone, slow", "1.0"]]
    svg = labels("front", found, tmp_path, metric="force")
    assert "<!-- controller alone, slow -->" in svg
    assert "force above the limit 5 N [%]" in header
    header, _ = front_rows(experiment, finding(arms[0], pressing(outcome, "other", 1.0, 7.0)))
    assert "force above its limit [%]" in header
    without = outcome("no limit", **{"metrics/force": 3.0, "metrics/force_p99": 4.0})
    without.point.config["controller"] = ZERO
    without.point.config["env"]["metrics"] = {"force": {"unit": "N"}}
    header, rows = front_rows(experiment, finding(arms[0], without))
    assert not any("limit" in title for title in header)
    assert {len(row) for row in rows} == {len(header)}


def test_arms_of_a_front_may_have_scenarios_of_their_own(outcome, tmp_path):
    arms = [pressing(outcome, arm, 2.0) for arm in ("blind", "seeing")]
    for run in arms[1].runs:
        run.results["dark"] = run.results["misaligned"]
    found = finding(*arms)
    _, rows = front_rows(of("front", metric="force"), found)
    assert [row[:2] for row in rows] == [
        ["misaligned", "controller alone, blind"],
        ["misaligned", "controller alone, seeing"],
        ["misaligned", "blind"],
        ["misaligned", "seeing"],
        ["dark", "controller alone, seeing"],
        ["dark", "seeing"],
    ]
    assert "<!-- dark -->" in labels("front", found, tmp_path, metric="force")
    assert "| dark | seeing |" in page(of("table"), found)


def test_a_return_that_is_no_number_does_not_end_the_figure(outcome, tmp_path):
    made = without_success(outcome(curves={"return": [-4.0, np.nan, -2.0]}))
    assert "<!-- latest policy -->" in labels("tasks", finding(made), tmp_path)
