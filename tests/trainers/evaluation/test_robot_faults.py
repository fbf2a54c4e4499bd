"""A fault in an evaluation stops the robot; the episode is played again, unless the run is to end."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from rrl.robot import RobotFault
from rrl.trainers.evaluation import rollout
from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.requests import Requests
from rrl.trainers.seeds import Stream
from rrl.trainers.settings import EvaluationSettings
from toy_envs import PointMass


class Unreliable(PointMass):
    """Is silent in some of its steps."""

    silent_in = (7, 90)
    steps = 0

    def __init__(self, *args):
        super().__init__(*args)
        self.told = []

    def _reset(self, tensordict=None, **kwargs):
        self.told.append("reset")
        return super()._reset(tensordict, **kwargs)

    def _step(self, tensordict):
        type(self).steps += 1
        if self.steps in self.silent_in:
            self.told.append("silent")
            raise RobotFault("silent")
        return super()._step(tensordict)

    def stop(self):
        self.told.append("stop")


@pytest.fixture
def unreliable(factory, monkeypatch):
    """The environment of a robot, and what evaluates it."""
    monkeypatch.setattr(rollout, "RETRY", 0.0)
    monkeypatch.setattr(Unreliable, "steps", 0)
    base = Unreliable([1])
    requests, settings = Requests(), EvaluationSettings(episodes=3, slots=1)
    scenario = replace(factory, base=lambda num_envs: base)
    evaluator = Evaluator({"point": scenario}, settings, requests)
    yield base, evaluator, requests
    evaluator.close()


def test_the_robot_is_stopped_before_anything_else(unreliable):
    base, evaluator, _ = unreliable
    evaluator.controller("point", Stream.FOLLOWING, 3)
    after = base.told.index("silent") + 1
    assert base.told[after : after + 2] == ["stop", "reset"]
    assert base.told[-1] == "stop"


def test_nobody_tries_again_once_the_run_is_to_end(unreliable):
    base, evaluator, requests = unreliable

    def check():
        raise InterruptedError

    requests.check = check
    with pytest.raises(InterruptedError):
        evaluator.controller("point", Stream.FOLLOWING, 3)
    assert base.told == ["reset", "silent", "stop"]


def test_they_come_out_as_without_the_fault(factory, monkeypatch, caplog):
    monkeypatch.setattr(rollout, "RETRY", 0.0)
    caplog.set_level(logging.WARNING)
    returns = []
    for base in (PointMass, Unreliable):
        scenario = factory.with_overrides()
        scenario.__dict__.update(base=lambda num_envs, base=base: base([1]))
        evaluator = Evaluator({"point": scenario}, EvaluationSettings(episodes=3, slots=1))
        returns.append(evaluator.controller("point", Stream.FOLLOWING, 3).returns)
        evaluator.close()
    np.testing.assert_array_equal(*returns)
    assert caplog.text.count("played again: silent") == 1
