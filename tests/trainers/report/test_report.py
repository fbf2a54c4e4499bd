"""The report: what runs logged, on one page that opens anywhere."""

import json
from dataclasses import replace
from functools import partial

import imageio.v3 as iio
import numpy as np
import pytest

from browser import needs_chromium, opened
from logged_runs import EPISODES, FORCE, edit, episodes, make_run
from rrl.trainers.cli.main import main
from rrl.trainers.evaluation.episodes import Comparison
from rrl.trainers.evaluation.statistics import success_interval, wilson
from rrl.trainers.metric import Metric
from rrl.trainers.report import report
from rrl.trainers.report.charts import curves
from rrl.trainers.report.curves import curve
from rrl.trainers.report.learning_curve import learning_curve
from rrl.trainers.report.panels import LEARNING
from rrl.trainers.report.report import write_report
from rrl.trainers.report.runs import find_runs, group_runs


def test_a_page_of_one_group_holds_it_all(runs):
    source = write_report(find_runs(runs[:3]), runs[0] / "report.html").read_text()
    for heading in (
        "Final evaluation",
        "Learning",
        "Rescues",
        "Quantities",
        "Losses",
        "Safety limits",
        "Time",
        "Versions",
    ):
        assert f">{heading}" in source
    solved = np.arange(EPISODES) < np.array([[16], [17], [18]])
    low, high = success_interval(solved)
    assert f"85.0 [{np.floor(1000 * low) / 10}, {np.ceil(1000 * high) / 10}] %" in source
    assert "contact force, mean [N]" in source
    assert "20.00 → 31.00" in source
    assert json.loads((runs[0] / "versions.json").read_text())["torchrl"] in source


@needs_chromium
def test_runs_are_compared_and_switched_in_a_browser(runs, tmp_path):
    page = write_report(find_runs(runs), tmp_path / "comparison.html")
    with opened(page) as tab:
        assert tab.title() == "insertion-residual, insertion-rl"
        rows = [
            row.split("\t") for row in tab.locator("table").nth(1).locator("tr").all_inner_texts()
        ]
        assert rows[1][:2] == ["misaligned", "insertion-residual"]
        assert rows[1][-3:] == ["13", "0", "80, 85, 90"]
        assert rows[2][:3] == ["misaligned", "insertion-rl", ""]  # no controller to compare with
        differing = tab.locator("#section-8 ~ .wide table").first.inner_text()
        assert "insertion-rl" in differing
        assert "total_steps" not in differing
        chart = tab.locator(".chart").first
        visible = "e => e._fullData.filter(t => t.visible === true).map(t => t.name).sort()"
        names = chart.evaluate(visible)
        assert names.count("insertion-rl, seed 2") == 2  # success and return
        assert names.count("controller alone") == 2
        tab.get_by_label("seed 2").uncheck()
        tab.get_by_label("insertion-rl", exact=True).uncheck()
        names = chart.evaluate(visible)
        assert not [name for name in names if "seed 2" in name or "insertion-rl" in name]
        assert names.count("insertion-residual, seed 1") == 2
        tab.get_by_label("insertion-rl", exact=True).check()
        assert "insertion-rl" in chart.evaluate(visible)


def test_the_command_takes_runs_or_a_folder_of_runs(runs, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hidden = runs[0] / ".hydra"
    hidden.mkdir()
    (hidden / "config.yaml").write_text("name: as composed")
    assert main(["report", "outputs", "out=pages/all.html"]) == 0
    assert "insertion-residual, insertion-rl" in (tmp_path / "pages/all.html").read_text()
    assert main(["report", str(runs[1])]) == 0
    assert (runs[1] / "report.html").is_file()
    assert main(["report", "nothing"]) == 2
    assert "expected the directory of a run" in capsys.readouterr().err
    for wrong in ("to=x.html", f"run={runs[1]}"):
        assert main(["report", wrong]) == 2
        assert "expected their directories" in capsys.readouterr().err


def test_a_learning_curve_of_a_group_or_of_nothing(runs, tmp_path):
    (group,) = group_runs(find_runs(runs[:3]))
    out = learning_curve(group, tmp_path / "curve.png")
    assert out.stat().st_size > 10_000
    assert out.with_suffix(".svg").exists()
    (runs[0] / "metrics.csv").unlink()
    (group,) = group_runs(find_runs(runs[:1]))
    assert learning_curve(group, tmp_path / "none.png") is None


def test_what_is_handed_over_is_shown_beside_the_latest_policy(tmp_path):
    accepted = {"accepted": episodes(7, 25.0), "accepted_env_steps": 350}
    run = make_run(tmp_path / "run", compared=partial(Comparison, **accepted))
    (group,) = group_runs(find_runs([run]))
    curve = learning_curve(group, tmp_path / "curve.png").with_suffix(".svg").read_text()
    plain = make_run(tmp_path / "plain")
    (other,) = group_runs(find_runs([plain]))
    without = learning_curve(other, tmp_path / "plain.png").with_suffix(".svg").read_text()
    assert ("handed over" in curve, "handed over" in without) == (True, False)
    source = write_report(find_runs([run]), tmp_path / "page.html").read_text()
    assert "<td>misaligned, handed over</td>" in source
    assert "the policy after 350 environment steps" in source
    assert '"name":"insertion-residual, handed over"' in source
    assert "handed over" not in write_report(find_runs([plain]), tmp_path / "p.html").read_text()


def test_a_report_says_what_is_not_paired(tmp_path):
    run = make_run(tmp_path / "run", compared=partial(Comparison, frozen=False))
    source = write_report(find_runs([run]), tmp_path / "page.html").read_text()
    assert "The episodes of misaligned, aligned are not frozen" in source
    assert "Nothing was logged for: rescues and regressions" in source


def test_a_rate_that_is_no_number_is_a_gap(tmp_path):
    run = make_run(tmp_path / "run")
    with (run / "metrics.csv").open("a") as file:
        file.write("1050,eval/misaligned/success,nan\n1050,eval/misaligned/return,nan\n")
    (group,) = group_runs(find_runs([run]))
    low, high = group.curve("eval/{followed}/success").band(EPISODES)
    assert np.isnan([low[-1], high[-1]]).all() and np.isfinite([low[:-1], high[:-1]]).all()
    assert learning_curve(group, tmp_path / "curve.png")
    write_report([*group.runs], tmp_path / "page.html")


def test_every_point_has_the_interval_of_its_own_number_of_episodes(tmp_path):
    run = make_run(tmp_path / "run")
    rows = (run / "metrics.csv").read_text().splitlines(keepends=True)
    solved = "eval/misaligned/success,"
    rows = [row.rpartition(solved)[0] + solved + "0.5\n" if solved in row else row for row in rows]
    (run / "metrics.csv").write_text("".join(rows))
    edit(run, trainer={"seed": 0, "total_steps": 1000, "evaluation": {"episodes": 100}})  # resumed
    with (run / "metrics.csv").open("a") as file:
        file.write(f"1050,{solved}0.5\n1050,eval/misaligned/episodes,100\n")
    (band,) = (
        line for line in curves(group_runs(find_runs([run])), LEARNING[:1]).data if line.fill
    )
    low, high = band.y[: len(band.y) // 2] / 100, band.y[len(band.y) // 2 :][::-1] / 100
    assert np.allclose([low[0], high[0], low[-2], high[-2]], wilson(10, 20) * 2)
    assert np.allclose([low[-1], high[-1]], wilson(50, 100))


def test_groups_of_different_budgets_stand_side_by_side(tmp_path):
    runs = []
    for budget in (None, 25.0, 30.5):
        how = {"contact_force": Metric(**FORCE, budget=budget)}
        compared = partial(
            lambda how, *pair: Comparison(*(replace(e, declared=how) for e in pair)), how
        )
        runs.append(make_run(tmp_path / str(budget), compared=compared, budget=budget))
    source = write_report(find_runs(runs), tmp_path / "page.html").read_text()
    assert "contact force above its budget [%]" in source
    source = write_report(find_runs(runs[:2]), tmp_path / "page.html").read_text()
    assert "contact force above the budget 25 N [%]" in source


def lines(runs, name):
    """Lines of that name in the return's panel."""
    figure = curves(group_runs(find_runs(runs)), LEARNING[1:])
    return [trace for trace in figure.data if name in trace.name]


def test_what_has_only_begun_is_not_drawn_to_the_end_and_a_controller_is(tmp_path):
    begun, level = (make_run(tmp_path / n, arm=n) for n in ("rl", "controller"))
    whole = make_run(tmp_path / "whole")
    edit(level, trainer={"total_steps": 0})
    for run in (begun, level):
        rows = (run / "metrics.csv").read_text().splitlines()
        (run / "metrics.csv").write_text(
            "\n".join(rows[:1] + [r for r in rows if r[:2] == "0,"]) + "\n"
        )
    runs = [whole, begun, level]
    assert [trace.x.tolist() for trace in lines(runs, "insertion-rl")] == [[0]]
    assert [trace.x.tolist() for trace in lines(runs, "insertion-controller")] == [[0, 1000]]


def test_controllers_are_one_line_where_they_came_to_the_same(tmp_path):
    runs = [make_run(tmp_path / n, tau=t) for n, t in (("a", 0.1), ("b", 0.2), ("c", 0.3))]
    edit(runs[1], env={"robot": "another"})
    assert [trace.name for trace in lines(runs, "alone")] == ["controller alone"]
    rows = (runs[2] / "metrics.csv").read_text()
    (runs[2] / "metrics.csv").write_text(
        rows.replace("controller_return,-4.8", "controller_return,-3.5")
    )
    assert [trace.name for trace in lines(runs, "alone")] == [
        "controller alone",
        "controller alone, c",
    ]


def test_only_the_videos_that_do_not_fit_are_left_out(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "MAX_VIDEO_BYTES", 1000)
    run = make_run(tmp_path / "run")
    (run / "videos").mkdir()
    for name, size in (("a_large.mp4", 1500), ("b_small.mp4", 500)):
        (run / "videos" / name).write_bytes(bytes(size))
    source = write_report(find_runs([run]), tmp_path / "page.html").read_text()
    assert "run: b small" in source.replace("insertion-residual", "run")
    assert "a_large.mp4" in source


def test_a_page_needs_a_file(runs, tmp_path):
    with pytest.raises(IsADirectoryError, match="expected a file, got a folder"):
        write_report(find_runs(runs[:1]), tmp_path)
    assert not list(tmp_path.parent.glob(f".{tmp_path.name}*"))


def test_a_run_that_is_not_finished_is_shown_as_far_as_it_is(tmp_path):
    run = make_run(tmp_path / "run", finished=False)
    source = write_report(find_runs([run]), tmp_path / "page.html").read_text()
    assert "has no final evaluation yet" in source
    with (run / "metrics.csv").open("a") as file:
        file.write("1050,loss/loss_cr")  # the moment that it is read in
    write_report(find_runs([run]), tmp_path / "page.html")
    (run / "metrics.csv").unlink()
    assert "0 of 1000" in write_report(find_runs([run]), tmp_path / "page.html").read_text()


def test_a_curve_is_thinned_by_averages_and_keeps_its_end():
    points = {seed: [(t, float(t + seed)) for t in range(0, 100, 10)] for seed in (0, 1)}
    thin = curve(points).thinned(4)
    assert curve(points).thinned(100).steps.tolist() == list(range(0, 100, 10))
    assert thin.steps.tolist() == [20, 50, 80, 90]
    assert thin.values[0].tolist() == [10, 40, 70, 90]
    low, high = thin.band()
    assert np.allclose((low + high) / 2, thin.mean)
    assert np.allclose(high - low, 12.706, atol=1e-3)  # the t quantile of one degree of freedom


def test_a_video_of_all_seeds_is_shown_once(runs, tmp_path):
    folder = runs[0].parent / "videos"
    folder.mkdir()
    (folder / "misaligned_episode_3.mp4").write_bytes(bytes(10))
    source = write_report(find_runs(runs), tmp_path / "page.html").read_text()
    assert source.count("insertion-residual: misaligned episode 3") == 1


def test_only_groups_with_results_are_told_their_budgets(tmp_path):
    budget = {"budget": 25.0}
    runs = [
        make_run(tmp_path / "done", **budget),
        make_run(tmp_path / "begun", tau=0.5, finished=False, **budget),
    ]
    source = write_report(find_runs(runs), tmp_path / "page.html").read_text()
    assert source.count("Budget for the mean of contact force") == 1


def test_groups_look_different_though_there_are_more_than_colors(tmp_path):
    paths = [make_run(tmp_path / f"{i}", tau=0.01 + 0.01 * i) for i in range(9)]
    figure = curves(group_runs(find_runs(paths)), LEARNING[:1])
    means = [trace.line for trace in figure.data if (trace.meta or {}).get("Show") == "mean"]
    assert len({(line.color, line.dash) for line in means}) == 9


def test_a_long_name_is_not_cut_off(tmp_path):
    group = replace(group_runs(find_runs([make_run(tmp_path / "run")]))[0], label="a-name-" * 30)
    picture = iio.imread(learning_curve(group, tmp_path / "curve.png"))
    assert (picture[:, [0, -1]] == 255).all()


@pytest.mark.parametrize(
    ("arm", "shown"), [("residual", "20.00 → 30.00"), ("rl", "30.00"), ("controller", "20.00")]
)
def test_quantities_are_those_of_what_the_arm_has(tmp_path, arm, shown):
    runs = find_runs([make_run(tmp_path / "run", arm=arm)])
    assert f"<td>{shown}</td>" in write_report(runs, tmp_path / "report.html").read_text()
