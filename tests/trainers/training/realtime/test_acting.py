"""The loop that does not wait, driving a robot in this process."""

import math
import threading
import time
from contextlib import contextmanager
from functools import partial

import pytest
import torch
from tensordict.nn import TensorDictModule

from carriages import EPISODE_STEPS, Carriage, carriage_factory
from realtime_runs import wait_for
from rrl.trainers.requests import Request
from rrl.trainers.settings import RealTimeSettings
from rrl.trainers.storage.transition_log import TransitionLog
from rrl.trainers.training.interface import prepare
from rrl.trainers.training.policy_vector import flatten
from rrl.trainers.training.realtime.acting import Acting
from rrl.trainers.training.realtime.ending import Ending
from rrl.trainers.training.realtime.hand_over import HandOver, Weights
from rrl.transforms import Intervention


@pytest.fixture
def hand_over(tmp_path):
    return HandOver(tmp_path)


@pytest.fixture
def acting(settings, hand_over):
    """Has a robot driven while the body runs."""

    @contextmanager
    def act(robot, policy=None, late="controller", **changes):
        how = settings(
            collection="realtime",
            realtime=RealTimeSettings(priority=0, budget=1.0, late=late),
            n_step=1,
            total_steps=1000,
        )
        env, _, _ = prepare(how, carriage_factory(robot, **changes), lambda spec: None)
        policy = policy or TensorDictModule(torch.nn.Linear(2, 2), ["goal"], ["action"])
        hand_over.publish(Weights(0, 1, flatten(policy)))
        ending = Ending()
        actor = Acting(how, env, policy, None, env.base_env.pace, hand_over, ending)
        thread = threading.Thread(target=actor.run, daemon=True)
        thread.start()
        try:
            yield actor
        finally:
            ending.ask()
            thread.join(60)
            actor.thread.close()
            env.close()
        assert not thread.is_alive()

    return act


def test_a_judgement_between_two_episodes_ends_none(acting, hand_over):
    robot = Carriage(at_reset={2: lambda: hand_over.tell(Request.SUCCEEDED)})
    with acting(robot, judged=True) as actor:
        log = TransitionLog(actor.log.folder)  # a reader's own: the writer's counts as it writes
        wait_for(lambda: log.refresh() >= 4 * EPISODE_STEPS)
    following = log.read(0, 4 * EPISODE_STEPS)[0]["next"]
    ends = following["done"].flatten().nonzero().flatten() + 1
    assert ends.tolist() == [EPISODE_STEPS * n for n in (1, 2, 3, 4)]
    assert not following["success"].any()


@pytest.mark.parametrize("step", [4, EPISODE_STEPS])
def test_a_pause_stops_the_robot_in_whatever_step_it_comes(acting, hand_over, step):
    def pause():
        hand_over.tell(Request.PAUSE)
        told.append(len(robot.told))

    robot, told = Carriage({step: pause}), []
    with acting(robot):
        wait_for(lambda: told and "stop" in robot.told[told[0] :], 10.0)
        time.sleep(0.2)
        assert set(robot.told[told[0] :]) <= {"stop", "command"}  # one may be on its way
        here = len(robot.told)
        hand_over.tell(Request.GO_ON)
        wait_for(lambda: robot.told[here:])
        assert robot.told[here] == "reset"


class Recorded(Carriage):
    def __init__(self):
        super().__init__()
        self.commands = []

    def command(self, action):
        self.commands.append(action.tolist())
        super().command(action)


class Hesitates(torch.nn.Linear):
    """Does not answer in time in the step in which an operator lets go."""

    def forward(self, place):
        if place[0] == LETS_GO:
            time.sleep(0.05)
        return -torch.ones_like(place)


LETS_GO = 4  # where


class Dawdles(torch.nn.Linear):
    """Does not answer in time, the first ``often`` times."""

    def __init__(self, often=math.inf):
        super().__init__(2, 2)
        self.left = often

    def forward(self, place):
        self.left -= 1
        if self.left >= 0:
            time.sleep(0.02)
        return super().forward(place)


def test_a_late_step_holds_what_an_operator_has_commanded(acting):
    def hand(place):
        return torch.full_like(place, 0.1), place[..., :1] < LETS_GO

    operator = TensorDictModule(hand, ["end_effector_position"], ["operator_action", "taken_over"])
    intervention = partial(Intervention, operator, step_limit=2.0)
    policy = TensorDictModule(Hesitates(2, 2), ["end_effector_position"], ["action"])
    robot = Recorded()
    with acting(robot, policy, "hold", intervention=intervention):
        wait_for(lambda: len(robot.commands) > LETS_GO)
    near = [0.0, 0.0]  # the controller's -0.5, and the residual's 0.5
    assert robot.commands[LETS_GO] == near
    assert robot.commands[:LETS_GO] == [[pytest.approx(0.1)] * 2] * LETS_GO


def test_a_policy_that_is_always_late_does_not_have_the_robot_reset_for_ever(acting, monkeypatch):
    failures = []
    monkeypatch.setattr(threading, "excepthook", lambda failure: failures.append(failure.exc_value))
    policy = TensorDictModule(Dawdles(), ["end_effector_position"], ["action"])
    robot = Recorded()
    with acting(robot, policy, "stop"):
        wait_for(lambda: failures)
    (failure,) = failures
    assert "expected an answer of the policy within" in str(failure)
    assert "raise budget or period" in str(failure)
    assert robot.told.count("reset") >= 20
    assert not robot.commands


def test_a_robot_that_resets_in_no_time_outlives_a_busy_second(acting):
    policy = TensorDictModule(Dawdles(40), ["end_effector_position"], ["action"])
    robot = Recorded()
    with acting(robot, policy, "stop"):
        wait_for(lambda: robot.commands)
    assert robot.told.count("reset") > 20


def test_a_robot_stands_still_before_somebody_else_has_it(acting, hand_over):
    robot = Carriage()
    with acting(robot):
        wait_for(lambda: robot.told)
        with hand_over.having_robot():
            assert robot.told[-1] == "stop"
            here = len(robot.told)
            time.sleep(0.2)
            assert len(robot.told) == here
        wait_for(lambda: robot.told[here:])
