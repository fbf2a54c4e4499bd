"""Commands as they are typed in a hurry: side by side, swept, in a project with files of its own."""

import sys
import threading
from pathlib import Path

import pytest
import yaml

from rrl.trainers.cli import seeds
from rrl.trainers.cli.compose import OURS, compose_train
from rrl.trainers.cli.main import USAGE, main, new_directory
from rrl.trainers.launch.launchers import spawn
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


@pytest.mark.parametrize("command", ["report", "dashboard", "reproduce", "new"])
def test_every_command_helps(command, capsys):
    assert main([command, "--help"]) == 0
    assert USAGE in capsys.readouterr().out


@pytest.mark.parametrize("value", ["abc", "null", "2.5"])
def test_a_wrong_number_of_seeds_is_explained(value, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *SMALL, f"trainer.num_seeds={value}"]) == 2
    assert "trainer.num_seeds: " in capsys.readouterr().err
    assert not list(tmp_path.glob("outputs/*/*"))


def test_seeds_have_a_launcher_where_none_is_named(tmp_path, monkeypatch):
    class Launched(Exception):
        pass

    def launch(jobs, name, workers, *rest):
        raise Launched(name, workers)

    monkeypatch.setattr(seeds, "launch", launch)
    monkeypatch.setenv("RRL_TRACEBACK", "1")
    left_out = ["~launcher", "~disturbance"]
    with pytest.raises(Launched, match="'local', None"):
        main(["train", *SMALL, *left_out, "trainer.num_seeds=2", f"hydra.run.dir={tmp_path}/run"])


def test_every_failed_job_of_a_sweep_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", sys.argv)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    sweep = ["trainer.batch_size=0,-1", f"hydra.sweep.dir='{tmp_path}/sweep'"]
    assert main(["train", "-m", *SMALL, *sweep]) == 2
    lines = capsys.readouterr().err.splitlines()
    for number, (value, line) in enumerate(zip((0, -1), lines, strict=True)):
        assert f"job {number} (" in line
        assert f" trainer.batch_size={value} " in line
        assert "): trainer.batch_size: " in line


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "config.yaml: expected a run's configuration, got None"),
        ("- a\n", "config.yaml: expected a run's configuration, got ['a']"),
        ("a: [", 'config.yaml", line 1'),
    ],
)
def test_a_run_without_a_configuration_is_explained(text, message, tmp_path, capsys):
    (tmp_path / "config.yaml").write_text(text)
    assert main(["evaluate", f"run={tmp_path}"]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("command", ["evaluate", "render"])
def test_a_wrong_change_of_a_run_is_explained(command, tmp_path, capsys):
    config = compose_train(SMALL, None).config
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(config))
    change = "trainer.evaluation.final_episodes=-1"
    assert main([command, f"run={tmp_path}", change]) == 2
    said = capsys.readouterr().err
    assert f"rrl {command}: trainer.evaluation.final_episodes: " in said
    assert "pydantic" not in said


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ("residual_scale=[1.0,1.0]", "residual_scale"),
        (
            "disturbance={control_noise: {_target_: rrl.transforms.ControlNoise, mu: [0.1, 0.1]}}",
            "mu",
        ),
    ],
)
def test_a_list_of_another_length_than_the_action_leaves_nothing(
    change, name, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *SMALL, change, "hydra.run.dir=run"]) == 2
    captured = capsys.readouterr()
    assert f"{name}: expected one number or 3" in captured.err
    assert "to go on" not in captured.out
    assert not (tmp_path / "run").exists()


def test_a_file_of_the_project_hides_no_package_from_a_run(tmp_path):
    (tmp_path / "yaml.py").write_text("raise RuntimeError('not the package')\n")
    log = tmp_path / "log.txt"
    assert spawn(["--help"], log, cwd=str(tmp_path)).wait() == 0, log.read_text()
