"""Runs are found and grouped, and what is damaged is named and left out."""

import subprocess
import sys

import numpy as np
import pytest
import yaml

from logged_runs import EPISODES, STEPS, edit, make_run
from rrl.trainers.report.charts import curves, time_split
from rrl.trainers.report.panels import LEARNING
from rrl.trainers.report.report import write_report
from rrl.trainers.report.runs import find_runs, group_runs

NOT_A_RUN = yaml.safe_dump({"trainer": {"value": {}}, "env": {"value": {}}})
DAMAGED = {
    "results.json": ["null", '{"misaligned": null}', '{"misaligned": {"summary": {}}}'],
    "config.yaml": ["trainer: 3\nenv: {}\narm: rl", "[]", NOT_A_RUN],
}


@pytest.mark.parametrize(("name", "content"), [(n, c) for n, cs in DAMAGED.items() for c in cs])
def test_a_file_of_another_shape_is_named_and_the_rest_is_shown(tmp_path, caplog, name, content):
    runs = [make_run(tmp_path / arm, arm=arm) for arm in ("residual", "rl")]
    (runs[0] / name).write_text(content)
    source = write_report(find_runs([tmp_path]), tmp_path / "page.html").read_text()
    assert str(runs[0] / name) in caplog.text
    assert "insertion-rl" in source


def test_what_stands_inside_a_run_is_no_run(tmp_path, caplog):
    run = make_run(tmp_path / "runs" / "one")
    (run / "wandb/run-1/files").mkdir(parents=True)
    (run / "wandb/run-1/files/config.yaml").write_text(NOT_A_RUN)
    assert [found.path for found in find_runs([tmp_path / "runs"])] == [run]
    assert not caplog.text


def test_seeds_that_differ_in_nothing_measured_are_one_group(runs):
    edit(
        runs[1], trainer={"keys": True, "threads": 2, "checkpoint": {"every": 7}}, render={"fps": 7}
    )
    assert [len(group.runs) for group in group_runs(find_runs(runs[:3]))] == [3]


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


def test_the_parts_of_a_bar_add_up_to_the_time_of_a_run(runs):
    """Whatever else is measured within the parts of the loop."""
    figure = time_split(group_runs(find_runs(runs)))
    assert [bar.name for bar in figure.data] == ["collect", "update"]
    assert {sum(seconds) for seconds in zip(*(bar.x for bar in figure.data), strict=True)} == {
        3.0 * len(STEPS)
    }


def test_runs_of_one_name_are_told_apart_by_their_directories(tmp_path):
    paths = [make_run(tmp_path / "a" / "1"), make_run(tmp_path / "a" / "2", tau=0.02)]
    assert [run.label for run in find_runs(paths)] == ["1", "2"]
    paths.append(make_run(tmp_path / "a" / "2" / "again", tau=0.03))
    assert [run.label for run in find_runs(paths[1:])] == ["2", "2/again"]


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


def test_a_run_that_ended_early_does_not_shorten_the_others(runs):
    rows = (runs[0] / "metrics.csv").read_text().splitlines(keepends=True)
    early = rows[:1] + [row for row in rows[1:] if int(row.partition(",")[0]) <= 400]
    (runs[0] / "metrics.csv").write_text("".join(early))
    (group,) = group_runs(find_runs(runs[:3]))
    found, name = group.curve("eval/{followed}/success"), "eval/misaligned/success"
    assert found.steps.tolist() == list(STEPS)
    assert [len(column) for column in found.columns] == [3] * 9 + [2] * 12
    both = [[dict(run.metrics[name])[step] for run in group.runs[1:]] for step in (450, 1000)]
    assert found.mean[[9, -1]].tolist() == [sum(pair) / 2 for pair in both]
    low, high = found.band(group.followed_episodes(found.steps))
    assert (low < high).all()
    drawn = curves([group], LEARNING).data
    assert [line.x[-1] for line in drawn if line.meta.get("Show") == "mean"] == [1000, 1000]
    assert "of 3 runs" in drawn[0].hovertemplate


def test_what_runs_log_at_steps_of_their_own_keeps_a_curve(runs):
    for number, run in enumerate(runs[:3]):
        with (run / "metrics.csv").open("a") as file:
            for step in range(100 + number, 1000, 70 + number):
                file.write(f"{step},train/return,{number}\n")
    (group,) = group_runs(find_runs(runs[:3]))
    found = group.curve("train/return")
    assert [found.steps[0], found.steps[-1]] == [100, 966]
    assert [len(column) for column in found.columns[:3]] == [1, 2, 3]
    assert found.mean[2:].tolist() == [1.0] * (len(found.steps) - 2)
    assert found.thinned(5).mean[-1] == 1.0
    low, high = found.band()
    assert np.isnan([low[0], high[0]]).all() and (low < high)[1:].all()


def test_a_return_that_is_no_number_is_no_mean_of_the_others(runs):
    with (runs[0] / "metrics.csv").open("a") as file:
        file.write("1000,eval/misaligned/return,nan\n")
    (group,) = group_runs(find_runs(runs[:3]))
    assert np.isnan(group.curve("eval/{followed}/return").mean).tolist() == [False] * 20 + [True]
