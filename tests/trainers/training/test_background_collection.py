"""Collecting while the updates run: the same run whenever it happens, and nothing is left behind."""

import os
import signal
import time
from dataclasses import replace
from functools import partial

import pytest
import torch
from torchrl.modules import OrnsteinUhlenbeckProcessModule

from rrl.algorithms import SAC, mlp, no_exploration
from rrl.trainers.settings import CheckpointSettings, EvaluationSettings
from rrl.trainers.storage.checkpoints import newest_whole
from rrl.trainers.training.interruption import Interrupted
from rrl.trainers.training.torch_setup import COLLECTOR_OFFSET
from toy_envs import PointMass, RememberingPointMass


class Slow(RememberingPointMass):
    """Takes its time, or fails, where it is told to."""

    def __init__(self, num_envs=1, seconds=0.0, fails_at=None):
        super().__init__([num_envs])
        self.seconds, self.fails_at, self.calls = seconds, fails_at, 0

    def _step(self, tensordict):
        self.calls += 1
        time.sleep(self.seconds)
        if self.calls == self.fails_at:
            raise ValueError("the gripper is open")
        return super()._step(tensordict)


@pytest.fixture
def make(make_trainer, factory):
    """Builds an overlapped trainer; 20 steps a collection, checkpoints every 60."""

    def make(run_dir="run", base=Slow, **changes):
        values = {
            "environment": replace(factory, base=base),
            "exploration": partial(OrnsteinUhlenbeckProcessModule, eps_init=0.5, dt=1.0),
            "collection": "overlap",
            "total_steps": 180,
            "warmup_steps": 40,
            "evaluation": EvaluationSettings(every=60, episodes=2, final_episodes=2, slots=2),
            "checkpoint": CheckpointSettings(every=60),
        }
        return make_trainer(run_dir, **{**values, **changes})

    return make


def run(trainer):
    with trainer:
        trainer.run()
    return trainer


def same(one, other):
    expected, actual = one.agent.state_dict(), other.agent.state_dict()
    tensors = [k for k, v in expected.items() if isinstance(v, torch.Tensor)]
    return (one.replay.storage[:] == other.replay.storage[:]).all() and all(
        torch.equal(expected[k], actual[k]) for k in tensors
    )


def test_a_run_depends_neither_on_timing_nor_on_where_it_stopped(make):
    whole = run(make("whole", base=partial(Slow, seconds=0.002)))
    run(make("broken", total_steps=120))
    second = make("broken")
    second.resume()
    assert second.env_steps == 120
    assert same(whole, run(second))


@pytest.mark.slow
def test_every_round_acts_with_the_policy_of_the_round_before(make):
    """Round k acts with the parameters that round k - 2 left: written out as a loop in turn."""
    overlapped = run(make("overlapped", agent=None))
    lagging = make("lagging", collection="turn")
    policy, parameters = lagging.agent.policy, list(lagging.agent.policy.parameters())
    acting = [p.detach().clone() for p in parameters]
    torch.manual_seed(lagging.settings.seed + COLLECTOR_OFFSET)
    while lagging.env_steps < 180:
        newest = [p.detach().clone() for p in parameters]
        for p, value in zip(parameters, acting, strict=True):
            p.data.copy_(value)
        transitions, _ = lagging.collection.collect(lagging.env_steps)
        for p, value in zip(parameters, newest, strict=True):
            p.data.copy_(value)
        acting = newest
        lagging.store.extend(transitions)
        lagging.counters["env_steps"] += 20
        if lagging.env_steps >= 40:
            lagging.learning.update()
    assert policy is not None
    assert same(overlapped, lagging)
    lagging.close()


@pytest.mark.slow
def test_a_stochastic_policys_own_noise_is_part_of_a_checkpoint(make):
    sac = {"agent": partial(SAC, network=partial(mlp, hidden=[8])), "exploration": no_exploration}
    whole = run(make("whole", **sac))
    run(make("broken", total_steps=120, **sac))
    second = make("broken", **sac)
    second.resume()
    assert same(whole, run(second))


def test_what_the_environment_raises_is_raised_by_the_run(make):
    quiet = EvaluationSettings(every=0)  # it is the collection that fails
    with (
        make(base=partial(Slow, fails_at=70), evaluation=quiet) as trainer,
        pytest.raises(ValueError, match="the gripper is open"),
    ):
        trainer.run()
    assert trainer.store.log.count == 60


def test_a_process_that_dies_is_named_and_leaves_a_checkpoint(make):
    with make() as trainer:
        one_round = trainer._round

        def kill_at_80():
            if trainer.env_steps == 80:
                os.kill(trainer.collection._process.pid, signal.SIGKILL)
            one_round()

        trainer._round = kill_at_80
        with pytest.raises(RuntimeError, match="the collecting process died with exit status -9"):
            trainer.run()
    assert newest_whole(trainer.run_dir)[0].name == "checkpoint-000000000060"


def test_a_run_may_be_closed_twice(make, caplog):
    trainer = make(total_steps=60)
    trainer.close()
    trainer.close()
    assert not caplog.text


@pytest.mark.slow
def test_a_signal_finishes_what_is_under_way_and_saves_it(make):
    whole = run(make("whole"))
    trainer = make("broken", base=partial(Slow, seconds=0.002))
    one_round = trainer._round

    def signal_at_80():
        one_round()
        if trainer.env_steps == 80:
            assert trainer.collection.is_ahead
            os.kill(os.getpid(), signal.SIGTERM)

    trainer._round = signal_at_80
    with trainer, pytest.raises(Interrupted):
        trainer.run()
    assert trainer.env_steps == 100
    second = make("broken", base=partial(Slow, seconds=0.002))
    assert second.resume().name == "checkpoint-000000000100"
    assert same(whole, run(second))


@pytest.mark.slow
def test_a_run_goes_on_from_a_checkpoint_made_while_the_next_collection_was_under_way(make):
    whole = run(make("whole"))
    trainer = make("broken")
    one_round = trainer._round

    def break_at_100():
        if trainer.env_steps == 100:
            raise OSError("no space left")
        one_round()
        assert trainer.collection.is_ahead

    trainer._round = break_at_100
    with trainer, pytest.raises(OSError, match="no space left"):
        trainer.run()
    second = make("broken")
    assert second.resume().name == "checkpoint-000000000060"
    assert same(whole, run(second))


@pytest.mark.parametrize(
    ("batching", "num_envs", "batch_size"),
    [
        pytest.param("serial", 1, [], marks=pytest.mark.slow),
        pytest.param("serial", 2, [], marks=pytest.mark.slow),
        pytest.param("parallel", 2, [], marks=pytest.mark.slow),
        ("native", 2, None),
    ],
)
def test_every_kind_of_environment_is_collected_from(
    make_trainer, factory, batching, num_envs, batch_size
):
    base = point_mass if batching == "native" else partial(PointMass, batch_size)
    for collection in ("turn", "overlap"):
        trainer = make_trainer(
            f"{batching}-{num_envs}-{collection}",
            environment=replace(factory, base=base, batching=batching),
            num_envs=num_envs,
            collection=collection,
            total_steps=120,
            warmup_steps=60,
            evaluation=EvaluationSettings(every=0, final_episodes=2),
            checkpoint=CheckpointSettings(every=60),
        )
        assert run(trainer).store.log.count == 120


def point_mass(num_envs=1):
    return PointMass([num_envs])
