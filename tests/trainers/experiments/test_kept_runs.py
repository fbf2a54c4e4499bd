"""What is kept of runs gives the same figures, tables and numbers on a machine that has nothing else."""

import csv
import re
import shutil

import pytest
import yaml

from experiment_project import EXPERIMENT, SPREAD, write
from logged_runs import make_run
from rrl.trainers.experiments.kept_runs import keep
from rrl.trainers.experiments.numbers import COLUMNS
from rrl.trainers.launch.job import Job, write_config

ARMS = {"residual RL": ["arm=residual"], "RL alone": ["arm=rl"]}
CURVES = {"title": "A point that drifts", "paper": "none", "figure": "curves", "arms": ARMS}
SOURCES = {"first": ["arm=rl", "env.base.drift=0.03"]}
CHAIN = {**CURVES, "sources": SOURCES, "arms": {"from it": ["arm=rl", "init_from.run=run:first"]}}


@pytest.fixture
def experiment(project):
    def make(content, name="some"):
        write(project / f"configs/experiment/{name}.yaml", content)

    return make


def numbers(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def tables(report):
    """The tables of a page but those of its configurations, whose commands name the store."""
    page = report.read_text()
    return re.findall(r"<table.*?</table>", page, re.DOTALL)


@pytest.mark.slow
def test_figure_tables_and_numbers_come_from_what_is_kept(experiment, run, project):
    experiment({**CURVES, "overrides": ["trainer.acceptance.enabled=true"]})
    first, _ = run("some", data="kept")
    check_numbers(numbers(first.parent / "figures/some.csv"))
    shutil.move(project / "out", project / "gone")
    second, said = run("some", data="kept")
    assert "4 runs are taken from" in said
    assert "4 runs, 4 of them finished; 0 environment steps to go" in said
    first = project / "gone" / first.name
    assert tables(first) == tables(second)
    for name in ("figures/some.png", "figures/some.csv"):
        assert (first.parent / name).read_bytes() == (second.parent / name).read_bytes()
    kept = {p: p.read_bytes() for p in (project / "kept").rglob("*") if p.is_file()}
    run("some", data="kept", out="elsewhere")  # keeping what was taken changes nothing
    assert {p: p.read_bytes() for p in (project / "kept").rglob("*") if p.is_file()} == kept
    assert max(map(len, kept.values())) < 15_000
    assert not list((project / "kept").rglob("checkpoint*"))

    experiment({**CURVES, "overrides": ["trainer.batch_size=8"]}, "other")
    _, said = run("other", data="kept", workers=0)
    assert "0 runs are taken from" in said  # of another configuration
    assert "none of the 4 runs kept there is one of these" in said
    assert "4 runs, 0 of them finished; none is run now" in said


def check_numbers(rows):
    """There is a row for every run and evaluation."""
    assert list(rows[0]) == list(COLUMNS)
    found = [(r["arm"], r["seed"], r["env_steps"], r["evaluation"]) for r in rows]
    steps = [("0", "training"), ("100", "training"), ("200", "training"), ("200", "final")]
    assert found == [(arm, seed, *step) for arm in ARMS for seed in "01" for step in steps]
    assert all(0 <= float(row["latest_success"]) <= 1 for row in rows)
    assert all(row["handed_over_return"] for row in rows if row["arm"] == "residual RL")
    assert {row["episodes"] for row in rows} == {"4"}
    final = [row for row in rows if row["evaluation"] == "final"]
    assert all(float(row["wall_time_s"]) > 0 and "torch=" in row["versions"] for row in final)
    helped = [row for row in final if row["arm"] == "residual RL"]
    assert not any(row["rescues"] + row["controller_return"] for row in final if row not in helped)
    rescued = [float(row["rescues"]) - float(row["regressions"]) for row in helped]
    gains = [float(r["latest_success"]) - float(r["controller_success"]) for r in helped]
    assert rescued == pytest.approx([4 * gain for gain in gains])


@pytest.mark.slow
def test_how_widely_a_run_moved_is_kept_without_its_transitions(experiment, run, project):
    experiment(
        {**CURVES, "seeds": 1, "overrides": ["+env.base.dim=3"]},
    )
    experiment(
        {"title": "t", "paper": "p", "figure": "spread", "spread": SPREAD, "runs_of": "some"},
        "wide",
    )
    first, _ = run("some", data="kept")
    assert not list((project / "kept").rglob("positions.json"))  # nobody has asked for it
    assert not any("variance" in column for column in numbers(first.parent / "figures/some.csv")[0])
    _, said = run("wide", data="kept", out="another", workers=0)
    assert "0 runs are taken from" in said  # what is shown of them is not kept
    first, _ = run("wide", data="kept")
    second, _ = run("wide", data="kept", out="elsewhere")
    rows = [numbers(report.parent / "figures/wide.csv") for report in (first, second)]
    assert rows[0] == rows[1]
    assert float(rows[1][-1]["position_variance_z_cm2"]) > 0
    # What cannot be kept is said, and the others are kept.
    kept = sorted((project / "kept").iterdir())
    (project / "full").mkdir()
    (project / "full" / kept[0].name).touch()
    _, said = run("some", data="full", workers=0)
    assert f"{kept[0].name}/seed-0 is not kept in {project / 'full'}" in said.replace("\n", "")
    assert (project / "full" / kept[1].name / "seed-0/results.json").is_file()
    (project / "file").touch()
    with pytest.raises(ValueError, match="data: expected a folder, got the file"):
        run("some", data="file")


def test_a_kept_run_names_its_source_as_it_is_kept_wherever_the_store_is(tmp_path):
    """A path that YAML quotes, escapes and would break over lines."""
    store = tmp_path / ("Bob's: store #1 é, " + "long " * 30)
    source, path = store / "runs/first-12ab/seed-0", store / "runs/from it-34cd/seed-0"
    config = yaml.safe_load((make_run(path) / "config.yaml").read_text())
    config["env"]["inputs"] = {}
    job = Job(path, {**config, "init_from": {"run": str(source)}}, (source,))
    write_config(job.config, path)
    for _ in range(2):
        keep(job, tmp_path / "kept")
        text = (tmp_path / "kept/from it-34cd/seed-0/config.yaml").read_text()
        assert yaml.safe_load(text) == {**config, "init_from": {"run": "first-12ab/seed-0"}}


def test_a_kept_run_says_what_was_run_when_its_settings_have_more_entries(tmp_path):
    """A later version's configuration of the same run has a setting that was not there before."""
    path = tmp_path / "store/runs/some-12ab/seed-0"
    config = yaml.safe_load((make_run(path) / "config.yaml").read_text())
    config["env"]["inputs"] = {}
    write_config(config, path)
    keep(Job(path, config, ()), tmp_path / "kept")
    before = {p: p.read_bytes() for p in (tmp_path / "kept").rglob("*") if p.is_file()}
    for name in ("checkpoints", "transitions"):  # as of a run that was taken
        shutil.rmtree(path / name, ignore_errors=True)
    later = {**config, "later": 1}
    write_config(later, path)
    keep(Job(path, later, ()), tmp_path / "kept")
    assert {p: p.read_bytes() for p in (tmp_path / "kept").rglob("*") if p.is_file()} == before
    keep(Job(path, later, ()), tmp_path / "another")
    (text,) = (p.read_text() for p in (tmp_path / "another").rglob("config.yaml"))
    assert yaml.safe_load(text)["later"] == 1


@pytest.mark.slow
def test_a_run_that_others_have_yet_to_start_from_is_trained(experiment, run, project):
    experiment(CHAIN)
    _, said = run("some", data="kept", workers=1)
    started = re.findall(r"started\s+some-(first|from-it)-\w+/seed-(\d)", said)
    assert started == [("first", "0"), ("from-it", "0"), ("first", "1"), ("from-it", "1")]
    configs = [p.read_text() for p in (project / "kept").rglob("config.yaml")]
    assert not any(str(project / "out") in text for text in configs)  # it says nothing elsewhere
    assert sum("run: some-first-" in text for text in configs) == 2
    shutil.rmtree(next((project / "kept").glob("some-from-it-*/seed-1")))
    _, said = run("some", data="kept", out="elsewhere")
    assert "2 runs are taken from" in said  # seed 0 of both
    trained = {p.parent.parent for p in (project / "elsewhere/runs").glob("*/*/checkpoints")}
    assert {path.name.rpartition("-")[0] for path in trained} == {"some-from-it", "some-first"}
    _, said = run("some", data="kept", out="a third")
    assert "4 runs are taken from" in said
    for folder in ("a third/runs", "kept"):
        shutil.rmtree(next((project / folder).glob("some-from-it-*/seed-1")))
    _, said = run("some", out="a third", workers=1)  # its source was taken, without its policy
    started = re.findall(r"started\s+some-(first|from-it)-\w+/seed-(\d)", said)
    assert started == [("first", "1"), ("from-it", "1")]


@pytest.mark.slow
def test_runs_are_kept_as_they_end_and_shown_without_running(experiment, run, project, monkeypatch):
    experiment({**EXPERIMENT, "seeds": 1})
    monkeypatch.setenv("BROKEN_DRIFT", "0.06")
    with pytest.raises(RuntimeError, match="1 runs are missing"):
        run("some", data="kept")
    report, said = run("some", data="kept", out="elsewhere", workers=0)
    assert "1 runs are taken from" in said
    assert "2 runs, 1 of them finished; none is run now" in said
    assert len(numbers(report.parent / "figures/some.csv")) == 4
    assert not list((project / "elsewhere").rglob("checkpoints"))


@pytest.mark.slow
def test_taking_is_done_again_where_it_was_interrupted(experiment, run, project):
    experiment({**CURVES, "seeds": 1, "arms": {"residual RL": ["arm=residual"]}})
    run("some", data="kept")
    run("some", data="kept", out="elsewhere", workers=0)
    (taken,) = (project / "elsewhere/runs").glob("*/seed-0")
    for name in ("results.json", "metrics.csv"):  # what was not there yet
        (taken / name).unlink()
    _, said = run("some", data="kept", out="elsewhere", workers=0)
    assert "1 runs are taken from" in said
    assert (taken / "metrics.csv").exists()
