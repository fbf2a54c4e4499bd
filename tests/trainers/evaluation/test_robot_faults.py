"""Episodes of an evaluation that a fault of the robot cuts short are played again."""

import logging

import numpy as np

from rrl.robot import RobotFault
from rrl.trainers.evaluation import rollout
from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.seeds import Stream
from rrl.trainers.settings import EvaluationSettings
from toy_envs import PointMass


class Unreliable(PointMass):
    """Is silent in some of its steps."""

    silent_in = (7, 90)
    steps = 0

    def _step(self, tensordict):
        type(self).steps += 1
        if self.steps in self.silent_in:
            raise RobotFault("silent")
        return super()._step(tensordict)


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
