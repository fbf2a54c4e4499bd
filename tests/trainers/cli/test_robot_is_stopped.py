"""Whatever ends a command that drives a robot, the robot is told to stop first."""

import signal
import subprocess
import sys
import time

import pytest

from robot_project import FEW, write_robot_project


@pytest.fixture
def run(tmp_path):
    """A run of the controller alone on a robot of the project in ``tmp_path``."""
    write_robot_project(tmp_path)
    command = rrl("train", *FEW, "hydra.run.dir=run")
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=120)
    (tmp_path / "calls.txt").unlink()
    return tmp_path / "run"


def rrl(*arguments):
    return [sys.executable, "-m", "rrl.trainers", *arguments]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_in_an_evaluation_stops_the_robot(run, number):
    calls = run.parent / "calls.txt"
    command = rrl("evaluate", f"run={run}", "trainer.evaluation.final_episodes=100")
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=run.parent, preexec_fn=all_heard, **quiet) as evaluation:
        try:
            while not (calls.exists() and calls.read_text().endswith("command\ncommand\n")):
                assert evaluation.poll() is None
                time.sleep(0.01)
            evaluation.send_signal(number)
            assert evaluation.wait(60) == 128 + number
        finally:
            evaluation.kill()
    assert calls.read_text().endswith("stop\n")


def all_heard():
    """Put back what a shell that starts the tests in the background, or ``nohup``, has ignored."""
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)
