"""A fault in an evaluation stops the robot; the episode is played again, a few times at most."""

import logging
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule

from rrl.controllers import ProportionalController
from rrl.keys import ACTION
from rrl.robot import RobotFault
from rrl.trainers import EvaluationSettings
from rrl.trainers.evaluation import rollout
from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.report.notes import notes
from rrl.trainers.report.tables import one_run, quantity_rows
from rrl.trainers.requests import Requests
from rrl.trainers.seeds import Stream
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


class Protected(PointMass):
    """An arm that stops by itself when it is pushed to where the controller does not go."""

    faults, resets, with_success = 0, 0, True
    lately = True  # not before the second step of an episode

    def _reset(self, tensordict=None, **kwargs):
        type(self).resets += 1
        if self.resets % 5 == 1:  # it is not always back at once
            raise RobotFault("not there yet")
        return self._without(super()._reset(tensordict, **kwargs))

    def _step(self, tensordict):
        if tensordict[ACTION][0, 0] > 0.25 and bool(self._steps.max()) == self.lately:
            type(self).faults += 1
            raise RobotFault("protective stop")
        return self._without(super()._step(tensordict))

    def _observe(self):
        return super()._observe() | {"metrics": {"place": self._position[..., :1]}}

    def _without(self, td):
        return td if self.with_success else td.exclude("success")

    def stop(self):
        pass


@pytest.fixture(params=[(True, True), (True, False), (False, True)], ids=["", "at once", "return"])
def protected(request, factory, monkeypatch):
    """A scenario with an arm that stops by itself."""
    monkeypatch.setattr(rollout, "RETRY", 0.0)
    success, lately = request.param
    for name, value in (
        ("faults", 0),
        ("resets", 0),
        ("with_success", success),
        ("lately", lately),
    ):
        monkeypatch.setattr(Protected, name, value)
    return replace(
        factory,
        base=lambda num_envs=1: Protected([num_envs]),
        controller=partial(ProportionalController, gain=10.0, clip=0.2),
        disturbances=[],
    )


def test_an_episode_that_a_fault_ends_every_time_has_failed(protected):
    evaluator = Evaluator({"arm": protected}, EvaluationSettings(episodes=3, slots=1))
    hard = TensorDictModule(lambda: torch.ones(1, 2), in_keys=[], out_keys=[ACTION])
    compared = evaluator.compare(hard, "arm", Stream.FOLLOWING, 3)
    evaluator.close()
    assert Protected.faults == 3 * rollout.ATTEMPTS
    policy, alone = compared.residual, compared.controller
    assert np.isnan(policy.returns).all()
    assert np.isfinite(alone.returns).all()
    assert policy.faults.tolist() == [rollout.ATTEMPTS] * 3
    assert alone.faults.tolist() == [0] * 3
    assert np.isfinite(policy.metrics["place"]).all()
    if Protected.with_success:
        assert not policy.success.any()
        assert not policy.cut
    said = compared.summary()
    assert (said["faults"], said["controller_faults"]) == (9, 0)
    header, ((_, *cells),) = quantity_rows(one_run({"arm": compared}), {})
    assert dict(zip(header[1:], cells, strict=True))["robot faults"] == "0.00 \u2192 9.00"
    (found,) = (t for t in notes(one_run({"arm": compared}), {}) if t.startswith("Faults"))
    assert "arm controller 0, residual 9, handed over 0" in found
