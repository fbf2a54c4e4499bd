"""Run and working directories of every name that the file system allows."""

import os
import signal
from pathlib import Path

import pytest

from experiment_project import EXPERIMENT, write, write_project
from rrl.trainers.cli.main import as_path, main
from situation_commands import LONG, SMALL, checkpoints, shell, start, wait_for_training

NASTY = " lead,a[b](c){d}=e é'f\"g${x}$y%z#;@~:\\!*?&|<>` trail "
NAMES = {
    "everything": NASTY,
    "equals": "lr=0.1",
    "tilde": "~",
    "dash": "-m",
    "interpolation": "${name}",
    "line break": "a\nb\tc",
    "bytes that are no text": os.fsdecode(b"caf\xe9"),
}


def quiet(*arguments):
    assert main(arguments) == 0


@pytest.mark.slow
def test_every_command_takes_a_run_of_any_name(tmp_path, monkeypatch, capsys):
    home = tmp_path / NASTY
    home.mkdir()
    monkeypatch.chdir(home)
    quiet("train", *SMALL)
    (run,) = (home / "outputs").glob("*/*")
    moved = home / NASTY
    run.rename(moved)
    for given in (moved, Path(NASTY)):
        quiet("evaluate", f"run={given}")
    quiet("render", f"run={moved}")
    quiet("train", f"resume={NASTY}", "trainer.total_steps=150")
    assert checkpoints(moved) == [100, 150]
    quiet("report", NASTY, f"out={moved / NASTY}")
    assert (moved / NASTY).stat().st_size > 0
    shown = capsys.readouterr().out
    for path in (moved / "report.html", moved / NASTY):
        assert f"  {path}\n" in shown


def test_a_folder_called_like_the_home_is_itself_and_else_the_home_is_meant(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert as_path("~") == Path.home().resolve()
    (tmp_path / "~").mkdir()
    assert as_path("~") == tmp_path / "~"


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_printed_command_goes_on_when_it_is_pasted(tmp_path, name):
    home = tmp_path / NAMES[name]
    home.mkdir()
    with start("train", *LONG, cwd=home) as process:
        run = wait_for_training(home, process)
        process.send_signal(signal.SIGTERM)
        output, errors = process.communicate(timeout=100)
    assert process.returncode == 128 + signal.SIGTERM, errors
    (before,) = checkpoints(run)[-1:]
    command = output.partition(b"to go on with it:\n  ")[2].rstrip(b"\n")
    assert command.startswith(b"cd "), output
    script = command + f" trainer.total_steps={before + 50}".encode()
    result = shell(os.fsdecode(script), tmp_path)
    assert result.returncode == 0, result.stderr
    assert checkpoints(run)[-1] == before + 50
    assert b"\n  " + os.fsencode(run / "report.html") in result.stdout


@pytest.mark.slow
def test_several_seeds_and_runs_that_start_from_others(tmp_path):
    home = tmp_path / NASTY
    home.mkdir()
    for arguments in (
        [*SMALL, "trainer.num_seeds=2", "hydra.run.dir=first"],
        [*SMALL, "init_from.run=first/seed-0", "hydra.run.dir=second"],
        [*SMALL, "arm=rl", "hydra.run.dir=alone"],
        [*SMALL, "controller=policy", "controller.run=alone", "hydra.run.dir=third"],
    ):
        with start("train", *arguments, cwd=home) as process:
            _, errors = process.communicate(timeout=250)
        assert process.returncode == 0, errors
    result = shell('rrl report first second "$PWD"', home)
    assert result.returncode == 0, result.stderr
    assert b"\n" not in result.stdout.strip().replace(os.fsencode(home), b"")


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [1, 2])
def test_what_a_run_started_from_is_not_asked_for_again(tmp_path, monkeypatch, seeds):
    monkeypatch.chdir(tmp_path)
    quiet("train", *SMALL, "hydra.run.dir=source")
    several = f"trainer.num_seeds={seeds}"
    quiet("train", *SMALL, "init_from.run=source", several, "hydra.run.dir=run")
    Path("source").rename("archived")
    Path("elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    seed = "../run" if seeds == 1 else "../run/seed-1"
    quiet("evaluate", f"run={seed}")
    quiet("export", f"run={seed}")
    quiet("train", "resume=../run", "trainer.total_steps=150")
    assert checkpoints(Path(seed))[-1] == 150
    assert main(["train", *SMALL, "init_from.run=source"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_experiments_are_made_below_any_folder(tmp_path, name):
    home = tmp_path / NAMES[name]
    home.mkdir()
    write_project(home)
    arms = {"warm": ["init_from.run=run:before"]}
    warm = {**EXPERIMENT, "sources": {"before": []}, "arms": arms}
    write(home / "configs/experiment/warm.yaml", warm)
    with start("reproduce", "warm", cwd=home) as process:
        output, errors = process.communicate(timeout=280)
    assert process.returncode == 0, (output, errors)
    assert b"\n  " + os.fsencode(home / "out/report-warm.html") in output
