"""Commands as they are typed in a hurry: side by side, swept, in a project with files of its own."""

import threading
from pathlib import Path

import pytest
import yaml

from rrl.trainers.cli.compose import OURS, compose_train
from rrl.trainers.cli.main import main, new_directory
from situation_commands import SMALL, checkpoints, shell

FEW = " ".join(SMALL)


def test_runs_of_one_second_get_directories_of_their_own(tmp_path):
    made, together = [], threading.Barrier(8)

    def make():
        together.wait()
        made.append(new_directory(tmp_path / "outputs/run/2026-01-01_00-00-00"))

    threads = [threading.Thread(target=make) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(set(made)) == len(list((tmp_path / "outputs/run").iterdir())) == 8


@pytest.mark.slow
def test_three_seeds_from_a_loop_of_the_shell(tmp_path):
    loop = 'for s in 0 1 2; do rrl train $FEW trainer.seed=$s > out.$s 2>&1 & p="$p $!"; done\n'
    wait = "for each in $p; do wait $each || exit 1; done"
    result = shell(loop + wait, tmp_path, FEW=FEW)
    assert result.returncode == 0, [p.read_text() for p in tmp_path.glob("out.*")]
    runs = list(tmp_path.glob("outputs/*/*"))
    seeds = [yaml.safe_load((run / "config.yaml").read_text())["trainer"]["seed"] for run in runs]
    assert sorted(seeds) == [0, 1, 2]
    assert all(checkpoints(run) == [50, 100] for run in runs)


@pytest.mark.slow
def test_a_sweep_of_hydra_s_is_made_and_one_of_its_runs_resumed(tmp_path):
    sweep = f"rrl train -m {FEW} trainer.seed=3,4 'hydra.sweep.dir=a sweep'"
    more = "rrl train 'resume=a sweep/1' trainer.total_steps=150"
    result = shell(f"{sweep} && {more}", tmp_path)
    assert result.returncode == 0, result.stderr
    assert checkpoints(tmp_path / "a sweep/0") == [50, 100]
    assert checkpoints(tmp_path / "a sweep/1") == [100, 150]
    seeds = [
        yaml.safe_load((tmp_path / f"a sweep/{i}/config.yaml").read_text())["trainer"]["seed"]
        for i in (0, 1)
    ]
    assert seeds == [3, 4]


OWN = {
    "controller/proportional.yaml": ("gain: 0.5", "gain: 0.123", ("controller", "gain"), 0.123),
    "train.yaml": ("residual_scale: ", "residual_scale: 0.25 # ", ("residual_scale",), 0.25),
}


@pytest.mark.parametrize("name", OWN)
def test_a_file_of_the_project_comes_before_ours_and_is_named(tmp_path, monkeypatch, name):
    old, new, keys, value = OWN[name]
    text = (OURS / name).read_text()
    assert old in text
    own = tmp_path / "configs" / name
    own.parent.mkdir(parents=True)
    own.write_text(text.replace(old, new, 1))
    monkeypatch.chdir(tmp_path)
    composed = compose_train([], None)
    found = composed.config
    for key in keys:
        found = found[key]
    assert found == value
    assert composed.replaced == (own,)


def test_the_run_says_which_file_was_read(tmp_path, monkeypatch, capsys):
    own = tmp_path / "configs/safety/none.yaml"
    own.parent.mkdir(parents=True)
    own.write_text((OURS / "safety/none.yaml").read_text())
    monkeypatch.chdir(tmp_path)
    assert main(["train", *SMALL, "trainer.num_seeds=-1"]) == 2
    said = capsys.readouterr().out
    assert said == "reading configs/safety/none.yaml of this project instead of rrl's own\n"


def test_no_advice_about_somebody_else_s_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run/checkpoints/checkpoint-000000000050").mkdir(parents=True)
    assert main(["train", *SMALL, "hydra.run.dir=run"]) == 2
    captured = capsys.readouterr()
    assert "expected a directory without a run" in captured.err
    assert "resume=" not in captured.out + captured.err


def test_no_evaluation_before_the_end(tmp_path, monkeypatch, capsys):
    """``trainer.evaluation.every=0``: the first line of an evaluation is the final one's."""
    monkeypatch.chdir(tmp_path)
    assert main(["train", *SMALL, "hydra.run.dir=run"]) == 0
    lines = (tmp_path / "run/metrics.csv").read_text().splitlines()
    steps = {int(line.split(",")[0]) for line in lines if "eval/" in line or "final/" in line}
    assert steps == {100}
    assert "0 steps  success" not in capsys.readouterr().out


def test_a_clones_own_files_replace_nothing(monkeypatch):
    monkeypatch.chdir(Path(__file__).parents[2])
    assert compose_train([], None).replaced == ()
