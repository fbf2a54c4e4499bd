"""Whatever ends a command that drives a robot, the robot is told to stop first."""

import signal
import subprocess
import sys
import time

import pytest
import yaml

ROBOT = """
import numpy as np
from rrl.robot import Description, EntrySpec, Observation, Robot

class Carriage(Robot):
    description = Description(
        {"position": EntrySpec((1,)), "goal": EntrySpec((1,)), "reward": EntrySpec((1,))}, (-1.0,), (1.0,), 0.02
    )
    time = 0.0

    def _note(self, call):
        with open("calls.txt", "a") as file:
            file.write(call + "\\n")

    def observe(self):
        self.time += 0.02
        return Observation({name: np.zeros(1, np.float32) for name in self.description.entries}, self.time)

    def command(self, action):
        self._note("command")

    def reset(self, seed=None):
        self._note("reset")

    def stop(self):
        self._note("stop")
"""
ENV = {
    "name": "carriage",
    "base": {
        "_target_": "rrl.envs.RobotEnv",
        "robot": {"_target_": "carriage.Carriage"},
        "episode_steps": 50,
    },
    "batching": "serial",
    "max_episode_steps": 50,
    "inputs": {"position": {}},
    "scenarios": {"here": {}},
}
CONTROLLER = {"_target_": "rrl.controllers.ProportionalController", "position_key": "position"}


@pytest.fixture
def run(tmp_path):
    """A run of the controller alone on a robot of the project in ``tmp_path``."""
    (tmp_path / "carriage.py").write_text(ROBOT)
    for path, content in {"env": ENV, "controller": CONTROLLER}.items():
        (tmp_path / "configs" / path).mkdir(parents=True)
        (tmp_path / "configs" / path / "carriage.yaml").write_text(yaml.safe_dump(content))
    few = [
        "trainer.evaluation.every=0",
        "trainer.evaluation.episodes=1",
        "trainer.evaluation.final_episodes=1",
    ]
    few += ["arm=controller", "logger=csv", "render.enabled=false", "hydra.run.dir=run"]
    command = rrl("train", "env=carriage", "controller=carriage", *few)
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
