"""A person and an operator beside a loop that does not wait."""

import threading
import time
from dataclasses import replace
from functools import partial

import pytest
import torch
from tensordict import TensorDict

from rrl.controllers import ProportionalController
from rrl.interventions import ScriptedOperator
from rrl.trainers.loggers import read_metrics
from rrl.trainers.requests import Request
from rrl.trainers.settings import AcceptanceSettings, EvaluationSettings, RealTimeSettings
from rrl.trainers.training.interruption import Interrupted
from rrl.trainers.training.realtime.hand_over import FOLDER, HandOver
from rrl.transforms import Intervention
from toy_envs import PointMass


class Paced(PointMass):
    """A point that says how long its steps last."""

    control_period = 0.02

    def __init__(self, num_envs=1, **arguments):
        super().__init__([num_envs], **arguments)


def operator():
    controller = ProportionalController(gain=2.0, clip=1.0, unit=0.1)
    return ScriptedOperator(controller, share=0.5, noise=0.2)


@pytest.fixture
def make(make_trainer, factory):
    def make(**changes):
        return make_trainer(
            environment=replace(
                factory, base=Paced, intervention=partial(Intervention, operator, step_limit=0.3)
            ),
            collection="realtime",
            realtime=RealTimeSettings(priority=0, budget=1.0),
            evaluation=EvaluationSettings(every=0, final_episodes=2),
            acceptance=AcceptanceSettings(enabled=False),
            n_step=1,
            **changes,
        )

    return make


@pytest.mark.slow
def test_what_an_operator_did_is_stored_and_drawn(make):
    trainer = make(total_steps=400, intervention_share=0.25)
    trainer.run()
    trainer.close()
    stored = trainer.replay[:]
    taken = stored["intervened"].squeeze(-1)
    assert 0 < taken.sum() < 400
    assert (stored["action"].abs() <= 1).all()
    assert trainer.replay.sample(320)["intervened"].reshape(10, 32).sum(-1).min() >= 8
    record = read_metrics(trainer.run_dir)
    assert record["clock/robot"][-1][1] >= 0.9 * 400 * Paced.control_period
    assert "intervention/steps" in record


def test_a_person_judges_pauses_and_stops(make):
    trainer = make(total_steps=100_000)

    def play():
        with pytest.raises(Interrupted):
            trainer.run()

    thread = threading.Thread(target=play, daemon=True)
    thread.start()

    def steps():
        return trainer.collection._log.refresh()

    def wait_for(condition):
        end = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < end
            time.sleep(0.02)

    def ends_an_episode():
        trainer.person.succeeded()  # between two episodes it ends none
        lengths = trainer.replay[:]["next", "done"].flatten().nonzero().flatten().diff()
        return (lengths < 20).any()

    def stands_still(seconds):
        before = steps()
        time.sleep(seconds)
        return steps() == before

    wait_for(lambda: trainer.env_steps >= 20)
    wait_for(ends_an_episode)
    trainer.person.pause()
    wait_for(lambda: stands_still(0.5))
    assert stands_still(1.0)
    here = steps()
    trainer.person.go_on()
    wait_for(lambda: steps() > here)
    trainer.person.pause()
    wait_for(lambda: stands_still(0.5))
    here = steps()
    trainer.person.stop()
    thread.join(60)
    assert not thread.is_alive()
    assert steps() == here  # there may be a hand where the robot would go
    assert_judged_where_the_robot_is(trainer)
    trainer.close()
    assert not HandOver(trainer.run_dir / FOLDER).is_alive()


def assert_judged_where_the_robot_is(trainer):
    """A judgement is for the process, or for an evaluation while that has the robot."""

    def here():
        """Whether an evaluation's episode would be judged."""
        flag = torch.zeros(1, dtype=torch.bool)
        td = TensorDict({"done": flag, "truncated": flag.clone(), "success": flag.clone()}, [])
        trainer.collection.requests.judge(td)
        return bool(td["done"])

    process = HandOver(trainer.run_dir / FOLDER)
    process.heard()
    assert not here()  # of all that was judged in training
    trainer.person.succeeded()
    assert process.heard() == [Request.SUCCEEDED] and not here()
    with trainer.collection.paused():
        trainer.person.failed()
        trainer.person.pause()  # is for both
        assert process.heard() == [Request.PAUSE] and here() and trainer.person.paused
