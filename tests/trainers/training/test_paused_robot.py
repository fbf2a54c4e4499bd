"""A robot that nobody drives stands still: in a pause, after an evaluation, after a failure."""

import multiprocessing
import signal
import threading
import time
from dataclasses import replace
from functools import partial

import pytest
import torch

from carriages import EPISODE_STEPS, Carriage, carriage_factory
from rrl.envs import RobotEnv
from rrl.trainers.evaluation import rollout
from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.requests import Request, Requests, stop_of
from rrl.trainers.seeds import Stream
from rrl.trainers.settings import AcceptanceSettings, CheckpointSettings, EvaluationSettings
from rrl.trainers.training.interruption import Interrupted
from toy_envs import PointMass

PAUSE = 0.3
QUIET = {
    "evaluation": EvaluationSettings(every=0, final_episodes=1),
    "acceptance": AcceptanceSettings(enabled=False),
}


def test_the_step_that_finds_a_pause_ends_the_episode(make_trainer):
    changes = {"total_steps": 80, "warmup_steps": 40, "n_step": 1}
    robot = Carriage()
    with make_trainer(environment=carriage_factory(robot), **QUIET, **changes) as trainer:

        def go_on():
            while "stop" not in robot.told:
                time.sleep(0.01)
            trainer.person.go_on()

        trainer.person.pause()
        threading.Thread(target=go_on, daemon=True).start()
        trainer.run()
        ends = trainer.replay[:]["next", "done"].flatten().nonzero().flatten()
        assert ends[:3].tolist() == [0, EPISODE_STEPS, 2 * EPISODE_STEPS]
        assert not trainer.replay[:]["next", "terminated"].any()


def pausing(at, tell):
    """A robot during whose command ``at`` there begins a pause; it ends after the robot is stopped."""

    def pause():
        robot.told.append("pause")
        robot.at_stop = stopped
        tell(Request.PAUSE)

    def stopped():
        del robot.at_stop  # it may be told to stop more than once
        threading.Timer(PAUSE, go_on).start()

    def go_on():
        robot.told.append("go on")
        tell(Request.GO_ON)

    robot = Carriage({at: pause})
    return robot


def told_in_pause(robot):
    first, last = robot.told.index("pause"), robot.told.index("go on")
    return set(robot.told[first + 1 : last]), robot.told[last + 1 : last + 3]


class Arm(PointMass):
    """An environment of one's own whose steps and resets are a robot's."""

    def __init__(self, robot):
        super().__init__([])
        self.robot = robot

    def _step(self, tensordict):
        self.robot.command(tensordict["action"])
        return super()._step(tensordict)

    def _reset(self, tensordict=None, **kwargs):
        self.robot.reset()
        return super()._reset(tensordict, **kwargs)

    def stop(self):
        self.robot.stop()


@pytest.fixture
def arm_factory(factory):
    return lambda robot: replace(factory, base=partial(Arm, robot), batching="serial")


@pytest.mark.parametrize("of_ones_own", [False, True])
def test_a_robot_hears_nothing_but_stop_while_there_is_a_pause(
    make_trainer, arm_factory, of_ones_own
):
    robot = pausing(4, lambda request: trainer.collection.tell(request))
    environment = (arm_factory if of_ones_own else carriage_factory)(robot)
    with make_trainer(environment=environment, **QUIET) as trainer:
        data = trainer.collection.rollout(0)[0]
    assert told_in_pause(robot) == ({"stop"}, ["reset", "command"])
    following = data["next"]
    assert following["truncated"].flatten().nonzero().flatten()[0] == 4
    assert not following["terminated"].any()
    for key in ("end_effector_position", "goal"):
        assert torch.equal(following[key][4], data[key][4])
    assert following["reward"][4] == following["reward"][3]


def test_an_evaluated_episode_that_a_pause_cuts_short_is_played_again(monkeypatch, caplog):
    monkeypatch.setattr(rollout, "RETRY", 0.0)
    requests = Requests()
    robot = pausing(14, requests.take)
    settings = EvaluationSettings(episodes=3, slots=1)
    evaluator = Evaluator({"rail": carriage_factory(robot)}, settings, requests)
    episodes = evaluator.controller("rail", Stream.FOLLOWING, 3)
    evaluator.close()
    assert episodes.lengths.tolist() == [EPISODE_STEPS] * 3
    assert told_in_pause(robot) == ({"stop"}, ["reset", "command"])
    assert caplog.text.count("played again: a pause has stopped the robot") == 1


def test_a_stopped_robot_gets_no_command_before_its_next_reset():
    robot = Carriage()
    env = RobotEnv(robot, episode_steps=EPISODE_STEPS)
    td = env.reset().set("action", torch.zeros(2))
    env.stop()
    following = env.step(td)["next"]
    assert following["truncated"] and following["done"]
    assert robot.told == ["reset", "stop"]
    following = env.step(env.reset().set("action", torch.zeros(2)))["next"]
    assert not following["done"]
    assert robot.told[2:] == ["reset", "command"]
    env.close()


def test_training_goes_on_with_a_reset_where_an_evaluation_has_moved_the_robot(
    make_trainer, caplog
):
    robot = Carriage()
    changes = {
        "total_steps": 60,
        "warmup_steps": 45,
        "steps_per_collection": 15,
        "n_step": 1,
        "checkpoint": CheckpointSettings(every=0),
        "evaluation": EvaluationSettings(every=15, episodes=1, final_episodes=1),
    }
    with make_trainer(environment=carriage_factory(robot), **{**QUIET, **changes}) as trainer:
        trainer.run()
        stored = trainer.replay[:]
        assert robot.told[-1] == "stop"
    moved = stored["next", "end_effector_position"] - stored["end_effector_position"]
    assert torch.equal(moved, torch.ones_like(moved))
    assert "trainer.collection=realtime does not let it wait" in caplog.text


def test_a_robot_is_stopped_when_a_run_fails(make_trainer):
    robot = Carriage({15: lambda: 1 / 0})
    trainer = make_trainer(environment=carriage_factory(robot), **QUIET)
    with pytest.raises(ZeroDivisionError):
        trainer.run()
    assert robot.told[-1] == "stop"
    trainer.close()


def test_two_processes_never_drive_one_robot(make_trainer):
    before = set(multiprocessing.active_children())  # of other tests
    with pytest.raises(ValueError, match="expected turn or realtime for a robot"):
        make_trainer(environment=carriage_factory(Carriage), collection="overlap", **QUIET)
    assert set(multiprocessing.active_children()) <= before


def test_a_trainer_that_cannot_be_made_closes_its_environment(make_trainer):
    def agent(**_):
        raise ValueError("no such network")

    robot = Carriage()
    with pytest.raises(ValueError, match="no such network"):
        make_trainer(environment=carriage_factory(robot), agent=agent)
    assert robot.told[-1] == "close"


def test_a_flag_named_stop_is_no_robot():
    class Flagged(PointMass):
        stop = False

    assert stop_of(Flagged([1])) is None


def test_a_robot_is_not_reset_when_the_run_ends_in_a_pause():
    robot = Carriage()
    env, requests = RobotEnv(robot, episode_steps=EPISODE_STEPS), Requests()

    def check():
        raise Interrupted(signal.SIGINT)

    requests.check = check
    requests.take(Request.PAUSE)
    robot.at_stop = lambda: requests.take(Request.GO_ON)
    with pytest.raises(Interrupted):
        requests.before_reset(env, repeats=False)
    assert robot.told == ["stop"]
