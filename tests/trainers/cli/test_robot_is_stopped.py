"""Whatever ends a command that drives a robot, the robot is told to stop first."""

import signal
import subprocess
import sys
import time
from contextlib import contextmanager

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
    command = rrl("evaluate", f"run={run}", "trainer.evaluation.final_episodes=100")
    with driving(command, run.parent) as evaluation:
        evaluation.send_signal(number)
        assert evaluation.wait(60) == 128 + number
    assert (run.parent / "calls.txt").read_text().endswith("stop\n")


@pytest.mark.slow
def test_a_second_signal_in_training_ends_at_once_and_stops_the_robot(tmp_path):
    write_robot_project(tmp_path)
    command = rrl("train", *FEW, "arm=residual", "trainer.steps_per_collection=1000")
    with driving(command, tmp_path) as training:  # its round takes twenty seconds
        training.send_signal(signal.SIGTERM)
        time.sleep(1.0)
        assert training.poll() is None
        training.send_signal(signal.SIGTERM)
        assert training.wait(10) == -signal.SIGTERM
    assert (tmp_path / "calls.txt").read_text().endswith("stop\n")


@contextmanager
def driving(command, folder):
    """A process that commands the robot by now; killed at the end."""
    calls = folder / "calls.txt"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=folder, preexec_fn=all_heard, **quiet) as process:
        try:
            while not (calls.exists() and calls.read_text().endswith("command\ncommand\n")):
                assert process.poll() is None
                time.sleep(0.01)
            yield process
        finally:
            process.kill()


def all_heard():
    """Put back what a shell that starts the tests in the background, or ``nohup``, has ignored."""
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)
