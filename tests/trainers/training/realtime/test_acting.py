"""The loop that does not wait, driving a robot in this process."""

import threading
from contextlib import contextmanager

import pytest
import torch
from tensordict.nn import TensorDictModule

from carriages import EPISODE_STEPS, Carriage, carriage_factory
from realtime_runs import wait_for
from rrl.trainers.requests import Request
from rrl.trainers.settings import RealTimeSettings
from rrl.trainers.training.interface import prepare
from rrl.trainers.training.policy_vector import flatten
from rrl.trainers.training.realtime.acting import Acting, Ending
from rrl.trainers.training.realtime.hand_over import HandOver, Weights


@pytest.fixture
def hand_over(tmp_path):
    return HandOver(tmp_path)


@pytest.fixture
def acting(settings, hand_over):
    """Has a robot driven while the body runs."""

    @contextmanager
    def act(robot, **changes):
        how = settings(
            collection="realtime",
            realtime=RealTimeSettings(priority=0, budget=1.0),
            n_step=1,
            total_steps=1000,
        )
        env, _, _ = prepare(how, carriage_factory(robot, **changes), lambda spec: None)
        policy = TensorDictModule(torch.nn.Linear(2, 2), ["goal"], ["action"])
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
        wait_for(lambda: actor.log.refresh() >= 4 * EPISODE_STEPS)
    following = actor.log.read(0, 4 * EPISODE_STEPS)[0]["next"]
    ends = following["done"].flatten().nonzero().flatten() + 1
    assert ends.tolist() == [EPISODE_STEPS * n for n in (1, 2, 3, 4)]
    assert not following["success"].any()
