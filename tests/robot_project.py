"""A project with a robot that writes down what it is told, for tests of commands."""

from __future__ import annotations

from pathlib import Path

import yaml

ROBOT = """
import os

import numpy as np
from rrl.robot import Description, EntrySpec, Observation, Robot

class Carriage(Robot):
    description = Description(
        {"position": EntrySpec((1,)), "goal": EntrySpec((1,)), "reward": EntrySpec((1,))}, (-1.0,), (1.0,), 0.02
    )
    time = 0.0

    def _note(self, call):
        for name, line in {"calls.txt": call, "processes.txt": str(os.getpid())}.items():
            with open(name, "a") as file:
                file.write(line + "\\n")

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
FEW = [
    "env=carriage",
    "controller=carriage",
    "trainer.evaluation.every=0",
    "trainer.evaluation.episodes=1",
    "trainer.evaluation.final_episodes=1",
    "arm=controller",
    "logger=csv",
    "render.enabled=false",
]
"""The controller alone, for an episode."""


def write_robot_project(folder: Path) -> None:
    """Write the robot, ``calls.txt`` beside which it writes, and its configurations."""
    (folder / "carriage.py").write_text(ROBOT)
    for path, content in {"env": ENV, "controller": CONTROLLER}.items():
        (folder / "configs" / path).mkdir(parents=True)
        (folder / "configs" / path / "carriage.yaml").write_text(yaml.safe_dump(content))
