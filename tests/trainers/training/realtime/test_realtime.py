"""Collection in wall-clock time: real processes, real deaths, every transition once."""

import logging
import os
import signal
import time
from dataclasses import replace

import pytest
import torch
from torchrl.data import Unbounded

from realtime_runs import PERIOD, Paced, acted, learn, learn_and_be_killed, wait_for
from rrl.robot import RobotFault
from rrl.trainers.loggers import read_metrics
from rrl.trainers.settings import CheckpointSettings, EvaluationSettings
from rrl.trainers.training.interruption import Interrupted
from rrl.trainers.training.realtime.hand_over import HandOver
from runs import run
from toy_envs import EPISODE_STEPS, PointMass

SAID = 0.25  # what Hesitant says
ONE = CheckpointSettings(every=20, keep=1)


class Broken(Paced):
    """Fails in an episode's third step."""

    def _step(self, tensordict):
        self.calls = getattr(self, "calls", 0) + 1
        if self.calls == 30:
            raise ValueError("the gripper is open")
        return super()._step(tensordict)


class Wide(Paced):
    """Shows more than anybody reads: twenty records fill a file."""

    def __init__(self, num_envs=1):
        super().__init__(num_envs)
        self.observation_spec["scan"] = Unbounded((num_envs, 100_000))

    def _observe(self):
        return super()._observe() | {"scan": torch.zeros(*self.batch_size, 100_000)}


class Hesitant(torch.nn.Module):
    """Exploration that takes longer than a period, every fifth time."""

    in_keys, out_keys = ["action"], ["action"]

    def __init__(self, spec):
        super().__init__()
        self.calls = 0

    def forward(self, tensordict):
        self.calls += 1
        if self.calls % 5 == 0:
            time.sleep(3.5 * PERIOD)
        return tensordict.set("action", torch.full_like(tensordict["action"], SAID))


def assert_each_once(trainer):
    """The learner has stored what was acted, in order."""
    data = acted(trainer.run_dir)
    stored, _ = trainer.store.log.read(0, trainer.store.log.count)
    assert len(stored) == len(data) == trainer.settings.total_steps
    single = ("next", "end_effector_position") if trainer.settings.n_step == 1 else "goal"
    for key in ("end_effector_position", "action", single):
        assert torch.equal(stored[key], data[key]), key


def test_a_run_takes_every_transition_once_and_measures_its_timing(make):
    trainer = run(make())
    assert_each_once(trainer)
    timing = acted(trainer.run_dir)["timing"]
    assert timing["first"].flatten().nonzero().flatten().tolist() == list(range(0, 120, 20))
    assert timing["weights"].max() > 0
    times, first = timing["time"].flatten(), timing["first"].flatten()
    assert (times.diff()[~first[1:]]).mean() >= 0.9 * PERIOD
    assert "realtime/period_error_ms_p99" in (trainer.run_dir / "metrics.csv").read_text()
    assert not HandOver(trainer.run_dir / "realtime").is_alive()


def test_what_was_acted_is_counted_on_the_disk_and_forgotten_with_the_buffers(make):
    few = {"batch_size": 20, "buffer_capacity": 20, "checkpoint": ONE}
    trainer = run(make(base=Wide, total_steps=80, **few))
    (left,) = trainer.run_dir.glob("realtime/transitions/*.bin")
    assert left.name == "segment_000003.bin"
    in_memory, on_disk = trainer.collection.interface.room
    assert on_disk - in_memory == pytest.approx(left.stat().st_size / 20, rel=1e-3)
    assert in_memory < 100


def test_killed_learners_lose_nothing_and_the_environment_goes_on(make, tmp_path):
    changes = {"total_steps": 240, "realtime": {"period": 0.04}}
    changes["checkpoint"] = CheckpointSettings(every=80)  # the learner dies between two of them
    run_dir = tmp_path / "run"
    for until in (60, 100):
        learn_and_be_killed(make, until, **changes)
        before = len(acted(run_dir))
        assert HandOver(run_dir / "realtime").is_alive() or before == 240
        wait_for(lambda n=before: len(acted(run_dir)) > n or n == 240)
    trainer = learn(make, **changes)
    assert trainer.env_steps == 240
    assert_each_once(trainer)
    times = acted(run_dir)["timing", "time"].flatten()
    assert times.diff().min() > 0
    told = read_metrics(run_dir)
    size = trainer.settings.steps_per_round
    assert [step for step, _ in told["train/reward"]] == list(range(size, 241, size))
    returns = acted(run_dir)["next", "reward"].double().reshape(-1, EPISODE_STEPS).sum(1)
    assert sum(value for _, value in told["train/return"]) == pytest.approx(float(returns.sum()))


@pytest.mark.slow
def test_a_run_that_is_ended_in_its_first_round_begins_other_episodes(make):
    with make() as trainer:
        check = trainer.collection.requests.check

        def ended():
            if trainer.collection._log.refresh() >= 10:
                trainer.person.stop()
            check()

        trainer.collection.requests.check = ended
        with pytest.raises(Interrupted):
            trainer.run()
    second = make()
    second.resume()
    data = acted(run(second).run_dir)
    goals = data["goal"][data["timing", "first"].flatten()]
    assert len(torch.unique(goals, dim=0)) == len(goals)


def test_a_scenario_that_cannot_be_built_is_found_before_the_first_step(make, factory):
    def absent(**arguments):
        raise RobotFault("nobody answers")

    with make() as trainer:
        trainer.evaluator.scenarios["broken"] = replace(factory, base=absent)
        with pytest.raises(RuntimeError, match="scenario broken: nobody answers"):
            trainer.run()
        assert trainer.env_steps == 0


@pytest.mark.slow
def test_an_acting_process_that_died_is_named_and_another_takes_over(make):
    trainer = make(total_steps=600)
    one_round = trainer._round

    def kill_at_60():
        if trainer.env_steps == 60:
            pid = int((trainer.run_dir / "realtime" / "pid").read_text())
            os.kill(pid, signal.SIGKILL)
        one_round()

    trainer._round = kill_at_60
    with trainer, pytest.raises(RuntimeError, match="the acting process died"):
        trainer.run()
    second = make(total_steps=600)
    second.resume()
    assert_each_once(run(second))


def test_what_the_environment_raises_is_raised_by_the_run(make):
    with make(base=Broken) as trainer, pytest.raises(ValueError, match="the gripper is open"):
        trainer.run()
    assert len(acted(trainer.run_dir)) == 29


@pytest.mark.parametrize(
    "late", ["controller", *(pytest.param(x, marks=pytest.mark.slow) for x in ("hold", "stop"))]
)
def test_a_late_step_does_as_it_is_told(make, caplog, late):
    caplog.set_level(logging.INFO)
    trainer = run(make(exploration=Hesitant, realtime={"late": late, "budget": 0.9}))
    data = acted(trainer.run_dir)
    timing, actions = data["timing"], data["action"]
    missed = timing["missed"].flatten() > 0
    assert missed.any()
    assert "a policy's answer was late" in caplog.text
    in_time = actions[~missed]
    assert torch.equal(in_time, torch.full_like(in_time, SAID))
    if late == "controller":
        assert torch.equal(actions[missed], torch.zeros_like(actions[missed]))
    elif late == "hold":
        command = data["base_action"] + 0.5 * actions
        held = missed & ~timing["first"].flatten()
        wanted = ((command.roll(1, 0) - data["base_action"]) / 0.5).clamp(-1, 1)
        torch.testing.assert_close(actions[held], wanted[held])
    else:
        assert (timing["first"].flatten() & missed).any()
        assert len(timing["first"].flatten().nonzero()) > 120 / EPISODE_STEPS


@pytest.mark.parametrize("weights", ["episode", pytest.param(5, marks=pytest.mark.slow)])
def test_weights_change_where_they_may(make, weights):
    realtime = {"weights": weights, "period": 4 * PERIOD}  # time for the learner to give some
    data = acted(run(make(realtime=realtime, total_steps=200)).run_dir)
    timing = data["timing"]
    changes = timing["weights"].flatten().diff().nonzero().flatten() + 1
    assert len(changes)
    if weights == "episode":
        assert timing["first"].flatten()[changes].all()
    else:
        assert (changes % 5 == 0).all()


def test_an_evaluation_has_the_environment_to_itself(make):
    evaluation = EvaluationSettings(every=40, episodes=2, final_episodes=2)
    trainer = make(evaluation=evaluation)
    compare, seen = trainer.evaluator.compare, []

    def watched(*arguments):
        before = len(acted(trainer.run_dir)) if trainer.env_steps else 0
        result = compare(*arguments)
        seen.append((len(acted(trainer.run_dir)) if trainer.env_steps else 0) - before)
        return result

    trainer.evaluator.compare = watched
    assert_each_once(run(trainer))
    assert len(seen) >= 4
    assert set(seen) == {0}


def test_the_period_has_to_be_known(make):
    with pytest.raises(ValueError, match=r"trainer.realtime.period: expected a number of seconds"):
        make(base=lambda num_envs=1: PointMass([num_envs]))


def test_one_environment_is_stepped(settings):
    with pytest.raises(ValueError, match="collection: realtime steps one environment"):
        settings(num_envs=2, collection="realtime")
