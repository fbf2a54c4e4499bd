"""The report: what runs logged, on one page that opens anywhere."""

import json
import subprocess
import sys
import time
from functools import partial

import numpy as np
import pytest
import yaml

from browser import needs_chromium, opened
from rrl.trainers.cli.main import main
from rrl.trainers.evaluation.episodes import Comparison, Episodes, write_results
from rrl.trainers.evaluation.statistics import success_interval
from rrl.trainers.loggers import CSVLogger
from rrl.trainers.report.curves import curve
from rrl.trainers.report.learning_curve import learning_curve
from rrl.trainers.report.report import write_report
from rrl.trainers.report.runs import find_runs, group_runs
from rrl.trainers.storage.versions import write_versions

EPISODES = 20
STEPS = range(0, 1001, 50)


def episodes(solved, force):
    metrics = {"contact_force": np.full(EPISODES, force), "tilt": np.full(EPISODES, 0.1)}
    success = np.arange(EPISODES) < solved
    return Episodes(
        success - 5.0, np.full(EPISODES, 50), success, np.zeros(EPISODES, dtype=bool), metrics
    )


def make_run(folder, arm="residual", seed=0, finished=True, compared=Comparison, **changes):
    folder.mkdir(parents=True)
    env = {"name": "insertion", "scenarios": {"misaligned": {}, "aligned": {}}}
    config = {
        "name": f"insertion-{arm}",
        "arm": arm,
        "env": {**env, "metrics": {"contact_force": {"unit": "N", "reduce": "max"}}},
        "controller": {"_target_": "rrl.controllers.ZeroController"},
        "disturbance": {"control_noise": None},
        "algorithm": {"agent": {"_target_": "rrl.algorithms.TD3", "tau": 0.01} | changes},
        "trainer": {"seed": seed, "total_steps": 1000, "evaluation": {"episodes": EPISODES}},
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    logger = CSVLogger()
    logger.start(folder, config, 0)
    for step in STEPS:
        comparison = compared(episodes(step // 60 + seed, 30.0 + seed), episodes(4, 20.0))
        logger.log({f"eval/misaligned/{k}": v for k, v in comparison.summary().items()}, step)
        logger.log({"loss/loss_critic": 1.0 / (1 + step), "safety/step": 0.1}, step)
        logger.log({"action/residual_share": 0.4, "time/update": 2.0}, step)
    logger.finish()
    if finished:
        write_results({"misaligned": comparison, "aligned": comparison}, folder / "results.json")
        write_versions(folder)
    return folder


def make_group(folder, **arguments):
    return [make_run(folder / f"seed-{seed}", seed=seed, **arguments) for seed in (0, 1, 2)]


@pytest.fixture
def runs(tmp_path):
    folders = {arm: tmp_path / "outputs" / arm / "now" for arm in ("residual", "rl")}
    return [run for arm, folder in folders.items() for run in make_group(folder, arm=arm)]


def test_a_page_of_one_group_is_quick_and_holds_it_all(runs):
    start = time.perf_counter()
    source = write_report(find_runs(runs[:3]), runs[0] / "report.html").read_text()
    assert time.perf_counter() - start < 5.0  # 0.3 s on an idle machine
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
    low, high = success_interval([16, 17, 18], EPISODES)
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
    assert main(["report", "to=x.html"]) == 2
    assert "expected their directories" in capsys.readouterr().err


def test_runs_that_differ_by_the_seed_alone_are_a_group(runs, tmp_path):
    other = make_run(tmp_path / "other", tau=0.02)
    again = make_run(tmp_path / "again")  # the same seed tells nothing new
    groups = group_runs(find_runs([*runs, other, again]))
    assert [[run.seed for run in group.runs] for group in groups] == [
        *([0, 1, 2], [0, 1, 2], [0], [0]),
    ]
    found = groups[0].curve("eval/{followed}/success")
    assert found.seeds == (0, 1, 2)
    assert found.values[:, -1].tolist() == [0.8, 0.85, 0.9]
    (alone,) = group_runs(find_runs([other]))
    assert alone.curve("eval/{followed}/return").band() is None
    low, high = alone.curve("eval/{followed}/success").band(EPISODES)
    assert (low < high).all()


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


def test_a_torn_file_is_named_and_the_rest_is_shown(runs, tmp_path, caplog):
    (runs[0] / "results.json").write_text('{"misaligned": {"summ')
    (runs[1] / "config.yaml").write_text("trainer: {seed: [")
    (runs[2] / "metrics.csv").write_bytes(b"\xff\x00\x00")
    source = write_report(find_runs([tmp_path / "outputs"]), tmp_path / "page.html").read_text()
    for path in (runs[0] / "results.json", runs[1] / "config.yaml"):
        assert str(path) in caplog.text
    assert "insertion-residual" in source
    assert "seed-1" not in source.split("insertion-rl")[0]
    with pytest.raises(FileNotFoundError, match="expected the directory of a run"):
        find_runs([runs[1]])


def test_runs_are_read_without_torch(runs):
    program = "import sys; from rrl.trainers.report import report, runs; "
    program += "from pathlib import Path; print(runs.find_runs([Path(sys.argv[1])])[0].env_steps); "
    program += "assert 'torch' not in sys.modules"
    command = [sys.executable, "-c", program, str(runs[0])]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "1000\n"


def test_a_run_that_is_not_finished_is_shown_as_far_as_it_is(tmp_path):
    run = make_run(tmp_path / "run", finished=False)
    source = write_report(find_runs([run]), tmp_path / "page.html").read_text()
    assert "has no final evaluation yet" in source
    with (run / "metrics.csv").open("a") as file:
        file.write("1050,loss/loss_cr")  # the moment that it is read in
    write_report(find_runs([run]), tmp_path / "page.html")
    (run / "metrics.csv").unlink()
    assert "0 of 1000" in write_report(find_runs([run]), tmp_path / "page.html").read_text()


def test_runs_of_one_name_are_told_apart_by_their_directories(tmp_path):
    paths = [make_run(tmp_path / "a" / "1"), make_run(tmp_path / "a" / "2", tau=0.02)]
    assert [run.label for run in find_runs(paths)] == ["1", "2"]


def test_a_curve_is_thinned_by_averages_and_keeps_its_end():
    points = {seed: [(t, float(t + seed)) for t in range(0, 100, 10)] for seed in (0, 1)}
    thin = curve(points).thinned(4)
    assert curve(points).thinned(100).steps.tolist() == list(range(0, 100, 10))
    assert thin.steps.tolist() == [20, 50, 80, 90]
    assert thin.values[0].tolist() == [10, 40, 70, 90]
    low, high = thin.band()
    assert np.allclose((low + high) / 2, thin.mean)
    assert np.allclose(high - low, 12.706, atol=1e-3)  # the t quantile of one degree of freedom
