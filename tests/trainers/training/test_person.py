"""A person beside a run: pauses, judges, repeats and stops it, and knows what it will cost."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import pytest
import torch

from carriages import EPISODE_STEPS as CARRIAGE_STEPS
from carriages import Carriage, carriage_factory
from rrl.trainers.loggers import read_metrics
from rrl.trainers.seeds import Stream
from rrl.trainers.settings import AcceptanceSettings, EvaluationSettings
from rrl.trainers.training.interruption import Interrupted
from runs import assert_same_run, run
from toy_envs import EPISODE_STEPS, PointMass

NO_EVALUATION = EvaluationSettings(every=0, episodes=2, final_episodes=2, slots=2)
UNTESTED = AcceptanceSettings(enabled=False)
ALONE = EvaluationSettings(every=0, episodes=3, final_episodes=2, slots=1)
FOLLOWED = "drift", Stream.FOLLOWING, 3


@pytest.fixture
def make(make_trainer, simulated):
    def make(run_dir="run", **changes):
        quiet = {"evaluation": NO_EVALUATION, "acceptance": UNTESTED}
        return make_trainer(run_dir, environment=simulated, **{**quiet, **changes})

    return make


def at_step(trainer, number, action):
    """Do something before the ``number``-th step of the training environment."""
    env, steps = trainer.collection.env, [0]
    original = env.step

    def step(tensordict):
        steps[0] += 1
        if steps[0] == number:
            action()
        return original(tensordict)

    object.__setattr__(env, "step", step)


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
def test_a_pause_holds_the_environment_and_changes_nothing(make, collection):
    plain = make("plain", collection=collection)
    plain.run()
    plain.close()
    trainer = make("paused", collection=collection)
    trainer.person.pause()
    threading.Timer(1.5, trainer.person.go_on).start()
    start = time.monotonic()
    trainer.run()
    trainer.close()
    seconds = time.monotonic() - start
    assert seconds > 1.0
    assert torch.equal(trainer.replay[:]["action"], plain.replay[:]["action"])
    assert trainer.clock.seconds["robot"] < seconds - 1.0  # it did not move meanwhile


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
def test_a_run_that_is_paused_stops_when_asked(make, collection):
    trainer = make(collection=collection, total_steps=10_000)
    trainer.person.pause()
    threading.Timer(0.5, trainer.person.stop).start()
    with pytest.raises(Interrupted):
        trainer.run()
    trainer.close()
    again = make(collection=collection, total_steps=10_000)
    again.resume()
    assert again.env_steps == trainer.env_steps
    again.close()


@pytest.mark.parametrize("succeeded", [True, False])
def test_a_judgement_ends_the_episode(make, succeeded):
    trainer = make(total_steps=20, warmup_steps=0)
    judge = trainer.person.succeeded if succeeded else trainer.person.failed
    at_step(trainer, 7, judge)
    data = trainer.collection.rollout(0)
    trainer.close()
    done = data["next", "done"].flatten()
    assert done.nonzero().flatten().tolist() == [6]
    assert bool(data["next", "success"].flatten()[6]) is succeeded
    assert not data["next", "terminated"].any()  # the value of what follows is still there
    assert data["next", "truncated"].flatten()[6]


def test_success_may_be_a_persons_judgement_alone(make_trainer, factory):
    class Blind(PointMass):
        def __init__(self):
            super().__init__([1])
            del self.observation_spec["success"]

        def _observe(self):
            return {k: v for k, v in super()._observe().items() if k != "success"}

    environment = replace(factory, base=lambda num_envs=1: Blind(), judged=True)
    evaluation = EvaluationSettings(every=0, final_episodes=2, slots=1)
    trainer = make_trainer(
        environment=environment, evaluation=evaluation, acceptance=UNTESTED, total_steps=0
    )
    env = trainer.evaluator._env("drift", 2)
    original, steps = env.step, [0]

    def step(tensordict):
        steps[0] += 1
        if steps[0] % 5 == 0:
            trainer.person.succeeded()
        return original(tensordict)

    object.__setattr__(env, "step", step)
    found = trainer.run()["drift"].residual
    trainer.close()
    assert found.success.all() and (found.lengths == 5).all()


@pytest.mark.parametrize("evaluated", [False, True])
def test_a_judgement_between_two_episodes_ends_none(make_trainer, evaluated):
    robot = Carriage(at_reset={3: lambda: trainer.person.succeeded()})
    environment = carriage_factory(robot, judged=True)
    quiet = {"evaluation": ALONE, "acceptance": UNTESTED, "steps_per_collection": 50}
    trainer = make_trainer(environment=environment, **quiet)
    if evaluated:
        found = trainer.evaluator.controller("drift", Stream.FOLLOWING, 4)
        lengths, success = found.lengths.tolist(), found.success
    else:
        data = trainer.collection.rollout(0)["next"]
        lengths = (data["done"].flatten().nonzero().flatten() + 1).diff().tolist()
        success = data["success"]
    trainer.close()
    assert set(lengths) == {CARRIAGE_STEPS}
    assert not success.any()


@pytest.mark.parametrize("asked", ["succeeded", "repeat_start"])
def test_what_is_asked_of_several_environments_at_once_is_refused(make, caplog, asked):
    trainer = make(num_envs=2)
    at_step(trainer, 3, getattr(trainer.person, asked))
    data = trainer.collection.rollout(0)
    trainer.collection.rollout(0)
    trainer.close()
    assert not data["next", "done"][:, :-1].any()
    assert caplog.text.count("needs one environment at a time, these are 2") == 1


def starts(trainer, steps):
    """First observation of every episode in so many steps."""
    rounds = [trainer.collection.rollout(0) for _ in range(steps // EPISODE_STEPS)]
    goal = torch.cat([data["goal"] for data in rounds], 1)[0]
    return goal[::EPISODE_STEPS]


@pytest.mark.parametrize("evaluated", [False, True])
def test_a_start_is_repeated(make, evaluated):
    plain = make("plain", evaluation=ALONE)
    first, second, third, *_ = starts(plain, 80)
    before = plain.evaluator.controller(*FOLLOWED)
    plain.close()
    trainer = make("repeated", evaluation=ALONE)

    def ask():
        trainer.person.repeat_start()
        if evaluated:  # it begins where it is frozen to begin, and changes nothing
            played = trainer.evaluator.controller(*FOLLOWED)
            assert played.returns.tolist() == before.returns.tolist()

    at_step(trainer, EPISODE_STEPS + 5, ask)
    found = starts(trainer, 80)
    trainer.close()
    assert torch.equal(found, torch.stack([first, second, second, third]))


def test_a_run_that_was_stopped_goes_on_in_the_same_trainer(make):
    whole = run(make("whole"))
    trainer = make()
    for stopped_at in (80, 160):  # a fresh trainer, then a resumed one
        at_step(trainer, 70, trainer.person.stop)
        with pytest.raises(Interrupted):
            trainer.run()
        assert trainer.env_steps == stopped_at
        with pytest.raises(FileExistsError, match="resume it, or choose another"):
            trainer.run()
        trainer.resume()
    trainer.run()
    trainer.close()
    assert_same_run(whole, trainer)


def test_an_environment_without_a_state_says_that_it_cannot(make_trainer, caplog):
    trainer = make_trainer()
    at_step(trainer, 5, trainer.person.repeat_start)
    trainer.collection.rollout(0)
    trainer.close()
    assert "does not save its state: its next start is another one" in caplog.text


@pytest.mark.parametrize("collection", ["turn", pytest.param("overlap", marks=pytest.mark.slow)])
def test_training_robot_and_reset_time_are_counted_apart(make, collection):
    trainer = make(collection=collection, evaluation=EvaluationSettings(every=100, episodes=2))
    trainer.run()
    trainer.close()
    record = read_metrics(trainer.run_dir)
    for part in ("training", "robot", "reset"):
        values = [value for _, value in record[f"clock/{part}"]]
        assert values == sorted(values) and values[-1] > 0
        assert values[-1] == pytest.approx(trainer.clock.seconds[part])
    again = make(collection=collection, evaluation=EvaluationSettings(every=100, episodes=2))
    again.resume()
    assert 0 < again.clock.seconds["robot"] <= trainer.clock.seconds["robot"]
    again.close()


@pytest.mark.parametrize(
    ("every", "tested"),
    [
        (0, False),
        (100, True),
        pytest.param(100, False, marks=pytest.mark.slow),
        pytest.param(0, True, marks=pytest.mark.slow),
    ],
)
def test_how_many_episodes_are_played_is_said_before(make, caplog, every, tested):
    caplog.set_level("INFO", logger="rrl")
    shown = EvaluationSettings(every=every, episodes=4, final_episodes=6, slots=2)
    trainer = make(
        evaluation=shown, acceptance=AcceptanceSettings(enabled=tested, margin=0.4, episodes=10)
    )
    played = []
    play = trainer.evaluator._play

    def counted(policy, scenario, seed, episodes):
        played.append((trainer.env_steps, episodes))
        return play(policy, scenario, seed, episodes)

    trainer.evaluator._play = counted
    trainer.run()
    trainer.close()
    line = next(line for line in caplog.messages if "episodes on the environment" in line)
    bound = int(line.split("; ")[1].split()[0])
    total = sum(episodes for _, episodes in played)
    assert "10 in training" in line
    assert total <= bound - 10 <= total + 2 * 3 + (20 * 2 + 6 if tested else 0)
    if every == 0:
        assert all(env_steps == 200 for env_steps, _ in played), "nothing is evaluated before"
