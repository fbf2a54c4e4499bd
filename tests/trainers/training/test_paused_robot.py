"""A robot that nobody drives stands still: in a pause, after an evaluation, after a failure."""

import multiprocessing
import signal
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import torch

from rrl.envs import RobotEnv
from rrl.robot import Description, EntrySpec, Observation, Robot
from rrl.trainers.environment import Input
from rrl.trainers.evaluation import rollout
from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.requests import Request, Requests, stop_of
from rrl.trainers.seeds import Stream
from rrl.trainers.settings import AcceptanceSettings, CheckpointSettings, EvaluationSettings
from rrl.trainers.training.interruption import Interrupted
from toy_envs import PointMass

PERIOD, EPISODE_STEPS, PAUSE = 0.005, 10, 0.3
QUIET = {
    "evaluation": EvaluationSettings(every=0, final_episodes=1),
    "acceptance": AcceptanceSettings(enabled=False),
}


class Carriage(Robot):
    """Goes on with its last command, and writes down what it is told; its place counts commands."""

    description = Description(
        entries={"end_effector_position": EntrySpec((2,)), "goal": EntrySpec((2,))}
        | {"reward": EntrySpec((1,))},
        low=(-1.0, -1.0),
        high=(1.0, 1.0),
        period=PERIOD,
    )

    def __init__(self, at_command=None):
        self.told, self._clock, self._at_command = [], 0.0, at_command or {}
        self._moves = 0

    def observe(self):
        self._clock += PERIOD
        place = np.full(2, self._moves)
        entries = {"end_effector_position": place, "goal": np.ones(2), "reward": [0.0]}
        return Observation(entries, self._clock)

    def command(self, action):
        self.told.append("command")
        self._moves += 1
        if act := self._at_command.pop(self.told.count("command"), None):
            act()

    def reset(self, seed=None):
        self.told.append("reset")
        self._moves = 0

    def stop(self):
        self.told.append("stop")
        self.at_stop()

    def at_stop(self):
        """Nothing else."""

    def close(self):
        self.told.append("close")


@pytest.fixture
def driven(factory):
    """The environment of a robot, or of what makes one."""

    def make(robot):
        return replace(
            factory,
            base=lambda: RobotEnv(robot, episode_steps=EPISODE_STEPS),
            inputs={"end_effector_position": Input(), "goal": Input()},
            batching="serial",
            max_episode_steps=EPISODE_STEPS,
        )

    return make


def test_the_step_that_finds_a_pause_ends_the_episode(make_trainer, driven):
    changes = {"total_steps": 80, "warmup_steps": 40, "n_step": 1}
    robot = Carriage()
    with make_trainer(environment=driven(robot), **QUIET, **changes) as trainer:

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


def test_a_robot_hears_nothing_but_stop_while_there_is_a_pause(make_trainer, driven):
    robot = pausing(4, lambda request: trainer.collection.tell(request))
    with make_trainer(environment=driven(robot), **QUIET) as trainer:
        data = trainer.collection.rollout(0)
    assert told_in_pause(robot) == ({"stop"}, ["reset", "command"])
    assert data["next", "truncated"].flatten().nonzero().flatten().tolist() == [4, 14]


def test_an_evaluated_episode_that_a_pause_cuts_short_is_played_again(driven, monkeypatch, caplog):
    monkeypatch.setattr(rollout, "RETRY", 0.0)
    requests = Requests()
    robot = pausing(14, requests.take)
    settings = EvaluationSettings(episodes=3, slots=1)
    evaluator = Evaluator({"rail": driven(robot)}, settings, requests)
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
    make_trainer, driven, caplog
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
    with make_trainer(environment=driven(robot), **{**QUIET, **changes}) as trainer:
        trainer.run()
        stored = trainer.replay[:]
        assert robot.told[-1] == "stop"
    moved = stored["next", "end_effector_position"] - stored["end_effector_position"]
    assert torch.equal(moved, torch.ones_like(moved))
    assert "trainer.collection=realtime does not let it wait" in caplog.text


def test_a_robot_is_stopped_when_a_run_fails(make_trainer, driven):
    robot = Carriage({15: lambda: 1 / 0})
    trainer = make_trainer(environment=driven(robot), **QUIET)
    with pytest.raises(ZeroDivisionError):
        trainer.run()
    assert robot.told[-1] == "stop"
    trainer.close()


def test_two_processes_never_drive_one_robot(make_trainer, driven):
    before = set(multiprocessing.active_children())  # of other tests
    with pytest.raises(ValueError, match="expected turn or realtime for a robot"):
        make_trainer(environment=driven(Carriage), collection="overlap", **QUIET)
    assert set(multiprocessing.active_children()) <= before


def test_a_trainer_that_cannot_be_made_closes_its_environment(make_trainer, driven):
    def agent(**_):
        raise ValueError("no such network")

    robot = Carriage()
    with pytest.raises(ValueError, match="no such network"):
        make_trainer(environment=driven(robot), agent=agent)
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
