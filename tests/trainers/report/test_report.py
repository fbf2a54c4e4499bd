"""The report: what runs logged, on one page that opens anywhere."""

import json
import time

import numpy as np
import pytest
import yaml

from browser import needs_chromium, opened
from rrl.trainers.cli.main import main
from rrl.trainers.evaluation.episodes import Comparison, Episodes
from rrl.trainers.loggers import CSVLogger
from rrl.trainers.report.curves import curve
from rrl.trainers.report.report import write_report
from rrl.trainers.report.runs import find_runs
from rrl.trainers.report.summary import write_results
from rrl.trainers.storage.versions import write_versions

EPISODES = 20
STEPS = range(0, 1001, 50)


def episodes(solved, force):
    peaks = {"contact_force": np.full(EPISODES, force), "tilt": np.full(EPISODES, 0.1)}
    success = np.arange(EPISODES) < solved
    return Episodes(
        success - 5.0, np.full(EPISODES, 50), success, np.zeros(EPISODES, dtype=bool), peaks
    )


def make_run(folder, arm="residual", seeds=(0, 1, 2), finished=True, **changes):
    folder.mkdir(parents=True)
    config = {
        "name": f"insertion-{arm}",
        "arm": arm,
        "env": {"name": "insertion", "scenarios": {"misaligned": {}, "aligned": {}}},
        "controller": {"_target_": "rrl.controllers.ZeroController"},
        "disturbance": {"control_noise": None},
        "algorithm": {"agent": {"_target_": "rrl.algorithms.TD3", "tau": 0.01} | changes},
        "trainer": {"seed": seeds[0], "num_seeds": len(seeds), "total_steps": 1000},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    logger = CSVLogger()
    logger.start(folder, config, seeds, 0)
    for step in STEPS:
        comparisons = [
            Comparison(episodes(step // 60 + k, 30.0 + k), episodes(4, 20.0))
            for k in range(len(seeds))
        ]
        rows = [c.summary() for c in comparisons]
        logger.log(
            {f"eval/misaligned/{name}": [row[name] for row in rows] for name in rows[0]}, step
        )
        logger.log(
            {
                "loss/loss_critic": [1.0 / (1 + step)] * len(seeds),
                "safety/step": [0.1] * len(seeds),
            },
            step,
        )
        logger.log(
            {"action/residual_share": [0.4] * len(seeds), "time/update": [2.0] * len(seeds)}, step
        )
    logger.finish()
    if finished:
        write_results({"misaligned": comparisons, "aligned": comparisons}, list(seeds), folder)
        write_versions(folder)
    return folder


@pytest.fixture
def runs(tmp_path):
    return [make_run(tmp_path / "outputs" / arm / "now", arm=arm) for arm in ("residual", "rl")]


def test_a_page_of_one_run_is_quick_and_holds_it_all(runs):
    start = time.perf_counter()
    source = write_report(find_runs(runs[:1]), runs[0] / "report.html").read_text()
    assert time.perf_counter() - start < 5.0  # 0.3 s on an idle machine
    for heading in (
        "Final evaluation",
        "Learning",
        "Rescues",
        "Contact",
        "Losses",
        "Safety limits",
        "Time",
        "Versions",
    ):
        assert f">{heading}" in source
    assert "85.0% [72.6%, 97.4%]" in source  # 16, 17 and 18 of 20 are solved
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
        assert rows[1][-2:] == ["13.0", "0.0"]
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
    assert main(["report", "to=x.html"]) == 2
    assert "expected directories of runs" in capsys.readouterr().err


def test_a_run_that_is_not_finished_is_shown_as_far_as_it_is(tmp_path):
    run = make_run(tmp_path / "run", finished=False)
    source = write_report(find_runs([run]), tmp_path / "page.html").read_text()
    assert "has no final evaluation yet" in source
    with (run / "metrics.csv").open("a") as file:
        file.write("1050,0,loss/loss_cr")  # the moment that it is read in
    write_report(find_runs([run]), tmp_path / "page.html")
    (run / "metrics.csv").unlink()
    assert "0 of 1000" in write_report(find_runs([run]), tmp_path / "page.html").read_text()


def test_runs_of_one_name_are_told_apart_by_their_directories(tmp_path):
    paths = [make_run(tmp_path / "a" / "1"), make_run(tmp_path / "a" / "2", tau=0.02)]
    assert [run.label for run in find_runs(paths)] == ["1", "2"]


def test_a_curve_is_thinned_by_averages_and_keeps_its_end():
    points = {seed: [(t, float(t + seed)) for t in range(0, 100, 10)] for seed in (0, 1)}
    thin = curve(points).thinned(4)
    assert thin.steps.tolist() == [20, 50, 80, 90]
    assert thin.values[0].tolist() == [10, 40, 70, 90]
    low, high = thin.band()
    assert np.allclose((low + high) / 2, thin.mean)
    assert np.allclose(high - low, 12.706, atol=1e-3)  # the t quantile of one degree of freedom
