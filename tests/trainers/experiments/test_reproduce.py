"""The command: what is missing is run, what failed is named, what was killed goes on, and all of it is shown."""

import io
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from experiment_project import EXPERIMENT, SETTINGS, write
from rrl.trainers.cli import main as cli
from rrl.trainers.console import Output
from rrl.trainers.experiments.reproduce import reproduce
from rrl.trainers.launch.display import Display
from rrl.trainers.launch.job import Job
from rrl.trainers.loggers import read_metrics
from rrl.trainers.storage.files import lock
from rrl.trainers.training.interruption import Interrupted


def results(project):
    return {
        path.parent: path.stat().st_mtime_ns for path in project.glob("out/runs/*/*/results.json")
    }


def metrics(run_dir):
    rows = read_metrics(run_dir)
    return {
        name: series for name, series in rows.items() if not name.startswith(("time/", "clock/"))
    }


@pytest.mark.slow
def test_a_failed_run_is_named_and_tried_again_while_the_others_are_kept(project, run, monkeypatch):
    """One arm starts from a run that fails, the other does not."""
    arms = {"from it": ["arm=rl", "init_from.run=run:first"], "residual RL": ["arm=residual"]}
    content = {
        "figure": "curves",
        "sources": {"first": ["arm=rl", "env.base.drift=0.03"]},
        "arms": arms,
        "evaluated_at": [100, 200],
        "overrides": ["+env.scenarios.still={drift: 0.0}"],
    }
    write(
        project / "configs/experiment/chain.yaml",
        {"title": "A point that drifts", "paper": "none", **content},
    )
    monkeypatch.setenv("BROKEN_DRIFT", "0.03")
    with pytest.raises(
        RuntimeError, match="4 runs are missing, 2 failed; the same command tries them again"
    ):
        run("chain")
    said = (project / "said.txt").read_text()
    assert "FAILED chain-first-" in said
    assert "the arm has come off" in said
    assert "NOT STARTED chain-from-it-" in said
    finished = results(project)
    assert {path.parent.name.rpartition("-")[0] for path in finished} == {"chain-residual-rl"}

    monkeypatch.delenv("BROKEN_DRIFT")
    report, said = run("chain")
    assert "6 runs, 2 of them finished; 800 environment steps to go" in said
    after = results(project)
    assert finished.items() <= after.items()  # untouched
    ended = {path.parent.name.rpartition("-")[0]: time for path, time in after.items()}
    assert ended["chain-first"] < ended["chain-from-it"]
    for name in ("chain.png", "chain.svg"):
        assert (project / "out/figures" / name).stat().st_size > 5000
    page = report.read_text()
    assert "A point that drifts" in page
    assert "chain-from-it-" in page
    assert "success after 100 steps" in page and "success after 200 steps" in page
    assert "<td>still</td>" in page  # several scenarios, a row each

    _, said = run("chain")
    assert "6 runs, 6 of them finished; 0 environment steps to go" in said
    assert results(project) == after


def long_experiment(project):
    overrides = ["trainer.total_steps=1500", "trainer.evaluation.every=500"]
    content = {**EXPERIMENT, "figure": "curves", "overrides": overrides}
    write(
        project / "configs/experiment/long.yaml", {k: v for k, v in content.items() if k != "sweep"}
    )
    scale = {**SETTINGS["scales"]["tiny"], "seeds": 1}
    write(project / "configs/reproduce.yaml", {**SETTINGS, "scales": {"tiny": scale}})


def steps(project):
    rows = [read_metrics(path.parent) for path in project.glob("out/runs/*/*/metrics.csv")]
    return max((step for row in rows for points in row.values() for step, _ in points), default=0)


def wait_for(condition, seconds=200):
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.1)
    assert condition()


def test_ctrl_c_saves_the_runs_and_the_same_command_goes_on(project, run):
    long_experiment(project)

    def interrupt():
        wait_for(lambda: steps(project) >= 200)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(Interrupted):
        run("long")
    thread.join()
    assert "to go on:\n  rrl reproduce long" in (project / "said.txt").read_text()
    (run_dir,) = project.glob("out/runs/*/*")
    assert (
        "rrl train resume=" in (run_dir / "log.txt").read_text()
    )  # it ended by itself, with a checkpoint
    reached = steps(project)
    assert 200 <= reached < 1500
    assert sorted((run_dir / "checkpoints").iterdir())[-1].name == f"checkpoint-{reached:012d}"


def test_ctrl_c_while_the_runs_are_planned_is_no_error_of_hydra(project, folders, compose):
    signals = iter([signal.SIGINT])

    def interrupted(overrides):
        for number in signals:
            os.kill(os.getpid(), number)
        return compose(overrides)

    with pytest.raises(Interrupted):
        reproduce(["drift"], {}, interrupted, folders, Output(file=io.StringIO()))
    assert not results(project)


@pytest.mark.slow
def test_a_killed_command_takes_its_runs_along_and_the_next_one_goes_on(project):
    """SIGKILL for the command; its run gets SIGTERM, saves itself and ends."""
    long_experiment(project)
    command = [sys.executable, "-m", "rrl.trainers", "reproduce", "long"]
    parent = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT)
    wait_for(lambda: steps(project) >= 200)
    parent.kill()
    parent.wait()
    (run_dir,) = project.glob("out/runs/*/*")
    wait_for(lambda: "the run is on disk" in (run_dir / "log.txt").read_text())
    reached = steps(project)
    assert reached < 1500
    said = subprocess.run(
        [*command, "workers=1"], capture_output=True, text=True, check=True, timeout=250
    )
    assert "1 runs, 0 of them finished" in said.stdout
    assert f"resuming from {run_dir}/checkpoints/checkpoint-{reached:012d}" in (
        run_dir / "log.txt"
    ).read_text().replace("\n", "")
    assert results(project)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_ray_runs_them_and_saves_them_on_ctrl_c(project):
    pytest.importorskip("ray")
    long_experiment(project)
    command = [sys.executable, "-m", "rrl.trainers", "reproduce", "long", "launcher=ray"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT)
    wait_for(lambda: steps(project) >= 200, seconds=400)
    process.send_signal(signal.SIGINT)
    assert process.wait(150) == 128 + signal.SIGINT
    (run_dir,) = project.glob("out/runs/*/*")
    assert "the run is on disk" in (run_dir / "log.txt").read_text()
    assert not results(project)
    said = subprocess.run(command, capture_output=True, text=True, timeout=400)
    assert said.returncode == 0, said.stdout + said.stderr
    assert "resuming from" in (run_dir / "log.txt").read_text()
    assert results(project)


def test_the_command_line_explains_what_it_does_not_know(project, capsys):
    assert cli.main(["reproduce", "drfit"]) == 2
    assert "experiment: expected one of" in capsys.readouterr().err


def a_job(path):
    return Job(path, {"trainer": {"total_steps": 1000}})


def test_a_terminal_shows_runs_done_success_and_steps(tmp_path, monkeypatch):
    out = io.StringIO()
    monkeypatch.setattr(out, "isatty", lambda: True)
    console = Output(file=out)
    console.width = 160
    jobs = [a_job(tmp_path / name / "seed-0") for name in ("first", "second")]
    jobs[1].path.mkdir(parents=True)
    rows = ["env_steps,metric,value", "250,eval/drift/success,0.75", "300,loss/q,1"]
    (jobs[1].path / "metrics.csv").write_text("\n".join(rows) + "\n")
    display = Display(console)
    with display.showing(jobs, done=jobs[:1], slots=2):
        display.started(jobs[1])
        display.refresh()
    said = out.getvalue()
    assert "1 of 2 runs" in said
    assert "300 of 1000 steps, success 75%" in said


def test_the_end_of_a_log_that_is_not_there_is_said(tmp_path):
    assert "No such file" in a_job(tmp_path / "none").log_tail()


def test_two_commands_do_not_share_a_store(project, run):
    held = lock(project)
    try:
        with pytest.raises(BlockingIOError, match="another process is training"):
            run("drift", out=str(project))
        run("drift", out=str(project), workers=0)  # to look is allowed
    finally:
        os.close(held)
