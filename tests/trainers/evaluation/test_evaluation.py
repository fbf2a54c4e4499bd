"""Evaluation: frozen, paired, and the zero residual is the controller bit for bit."""

import random
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import TransformedEnv

from rrl.controllers import ProportionalController
from rrl.envs import InsertionEnv
from rrl.trainers.environment import EnvironmentFactory, Input
from rrl.trainers.evaluation.episodes import Comparison
from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.evaluation.rollout import (
    isolated_generators,
    rollout,
    run_episodes,
    zero_residual,
)
from rrl.trainers.seeds import Stream
from rrl.trainers.settings import EvaluationSettings
from rrl.transforms import ControlNoise
from toy_envs import PointMass

ZERO = TensorDictModule(torch.zeros_like, in_keys=["base_action"], out_keys=["action"])
"""The zero residual for any batch size."""


class Global(PointMass):
    """Draws its drift from the three global generators."""

    def _step(self, tensordict):
        drawn = np.random.rand() + random.random() + float(torch.rand(()))  # noqa: NPY002
        self._drift[0] = 0.06 * drawn
        return super()._step(tensordict)


def test_global_generators_are_seeded_for_the_episodes_and_put_back(factory):
    env = replace(factory, base=partial(Global, []), batching="serial").make(1)

    def draw():
        return random.random(), np.random.rand(), torch.rand(3).tolist()  # noqa: NPY002

    with isolated_generators(1):
        expected = draw()
    with isolated_generators(1):
        first = run_episodes(env, zero_residual(env), 3, seed=7, max_steps=50)
        assert draw() == expected
    random.seed(5)  # whatever happens outside
    second = run_episodes(env, zero_residual(env), 3, seed=7, max_steps=50)
    assert (first.returns == second.returns).all()
    with pytest.raises(KeyError), isolated_generators(1):
        raise KeyError
    with isolated_generators(1):
        assert draw() == expected


class Counting(PointMass):
    """Counts the steps of all slots."""

    steps = 0

    def _step(self, tensordict):
        Counting.steps += self.batch_size.numel()
        return super()._step(tensordict)


@pytest.mark.parametrize(("slots", "episodes"), [(100, 10), (4, 8), (4, 10), (7, 7)])
def test_only_the_episodes_that_count_are_played(factory, slots, episodes):
    made = replace(factory, base=lambda num_envs=1: Counting([num_envs]))
    evaluator = Evaluator({"one": made}, EvaluationSettings(slots=slots))
    env = made.make(1)
    assert evaluator.is_frozen("one")
    Counting.steps = 0
    first = evaluator.compare(ZERO, "one", Stream.FINAL, episodes)
    batches = -(-episodes // slots)
    assert episodes * 20 <= Counting.steps / 2 < (episodes + batches) * 20
    again = evaluator.compare(ZERO, "one", Stream.FINAL, episodes)
    assert again.controller is first.controller  # played once
    expected = run_episodes(
        env, zero_residual(env), episodes, evaluator.first_seed(Stream.FINAL), max_steps=50
    )
    assert (first.residual.returns == expected.returns).all()
    evaluator.close()


def test_followed_and_final_episodes_are_others(factory):
    evaluator = Evaluator({"one": factory}, EvaluationSettings())
    returns = [
        evaluator.compare(ZERO, "one", stream, 5).residual.returns
        for stream in (Stream.FOLLOWING, Stream.FINAL)
    ]
    assert not set(returns[0]) & set(returns[1])
    evaluator.close()


def test_a_rollout_gives_the_reset_and_every_step(factory):
    env = factory.make(2)
    steps = list(rollout(env, zero_residual(env), seed=3, max_steps=50, episodes=1))
    assert len(steps) == 21
    assert "reward" not in steps[0][0]
    assert all(running.tolist() == [True, False] for _, running in steps)
    assert steps[-1][0]["done"].all()
    assert (steps[1][0]["action"] == 0).all()


@pytest.mark.parametrize("slots", [1, 4, 10])
def test_the_frozen_set_does_not_depend_on_the_batch_size(factory, slots):
    def episodes(n):
        env = factory.make(n)
        return run_episodes(env, zero_residual(env), 10, seed=100, max_steps=50)

    expected, actual = episodes(10), episodes(slots)
    assert (expected.returns == actual.returns).all()
    assert (expected.success == actual.success).all()


def test_serial_batching_runs_the_same_episodes(factory):
    serial = EnvironmentFactory(
        base=partial(PointMass, []),
        controller=factory.controller,
        inputs=factory.inputs,
        batching="serial",
        max_episode_steps=50,
    )
    native = EnvironmentFactory(
        base=factory.base,
        controller=factory.controller,
        inputs=factory.inputs,
        max_episode_steps=50,
    )
    runs = []
    for env in (serial.make(1), serial.make(2), native.make(2)):
        runs.append(run_episodes(env, zero_residual(env), 4, seed=3, max_steps=50).returns)
    assert (runs[0] == runs[1]).all()
    assert (runs[0] == runs[2]).all()


def test_rescues_and_regressions_are_counted_against_the_same_episodes(factory):
    env = factory.make(20)
    controller = run_episodes(env, zero_residual(env), 20, seed=0, max_steps=50)
    # the drift is 0.6 of an action along x: a constant residual against it solves every episode
    against = TensorDictModule(
        lambda: torch.tensor([-0.6, 0.0]).expand(20, 2), in_keys=[], out_keys=["action"]
    )
    residual = run_episodes(env, against, 20, seed=0, max_steps=50)
    comparison = Comparison(residual, controller)
    summary = comparison.summary()
    assert summary["rescues"] == (residual.success & ~controller.success).sum() > 0
    assert summary["regressions"] == 0
    swapped = Comparison(controller, residual).summary()
    assert (swapped["rescues"], swapped["regressions"]) == (0, summary["rescues"])


@pytest.mark.parametrize(
    "noise", [None, partial(ControlNoise, mu=0.1, sigma=0.05)], ids=["clean", "noise"]
)
@pytest.mark.parametrize("variant", ["sim", "real"])
def test_zero_residual_is_the_controller_bit_for_bit(variant, noise):
    """With the residual transform and zero actions, and without it under the controller as a plain policy."""
    controller = partial(ProportionalController, gain=0.5, clip=0.5, unit=0.02)
    factory = EnvironmentFactory(
        base=partial(InsertionEnv, variant=variant),
        controller=controller,
        inputs={"blocks": Input()},
        disturbances=[noise] if noise else [],
    )
    env = factory.make(3)
    residual = run_episodes(env, zero_residual(env), 3, seed=5, max_steps=50)
    bare = InsertionEnv(variant=variant, num_envs=3)
    plain = TransformedEnv(bare, noise()) if noise else bare
    alone = run_episodes(plain, controller(out_key="action"), 3, seed=5, max_steps=50)
    assert (residual.returns == alone.returns).all()
    assert (residual.success == alone.success).all()
    for name, values in residual.metrics.items():
        assert (values == alone.metrics[name]).all()


def test_an_unknown_input_names_the_choices(factory):
    wrong = EnvironmentFactory(
        base=factory.base, controller=factory.controller, inputs={"position": Input()}
    )
    with pytest.raises(KeyError, match=r"end_effector_position.*'position'"):
        wrong.make(1)


def test_a_scale_of_the_wrong_length_is_named(factory):
    wrong = EnvironmentFactory(
        base=factory.base,
        controller=factory.controller,
        inputs={"goal": Input(scale=[1.0, 2.0, 3.0])},
    )
    with pytest.raises(ValueError, match=r"inputs\.goal\.scale: expected 1 or 2 numbers, got 3"):
        wrong.make(1)


def law(observation):
    return -observation


class Law:
    def act(self, observation):
        return -observation


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"base": PointMass([])}, TypeError, "base: expected what makes one, .* got a PointMass"),
        ({"controller": ZERO}, TypeError, "controller: expected what makes one, .* got a Tensor"),
        ({"controller": law}, TypeError, r"got the function law; .*\(FunctionController, law\)"),
        ({"controller": partial(law)}, TypeError, "controller: expected what .* the function law;"),
        ({"controller": Law()}, TypeError, "controller: expected what makes .*, got a Law; write"),
        ({"sensing": [ControlNoise()]}, TypeError, "sensing: expected what makes one, .* Control"),
        ({"inputs": "goal"}, TypeError, r"inputs: expected names in a list, got 'goal'"),
        ({"critic_inputs": "goal"}, TypeError, r"critic_inputs: expected names .*, got 'goal'"),
        ({"base": partial(PointMass, [])}, TypeError, 'takes num_envs, .* batching="serial"'),
    ],
)
def test_what_is_no_factory_of_the_right_kind_is_named(factory, changes, error, message):
    with pytest.raises(error, match=message):
        replace(factory, **changes).make(1)


def test_what_a_base_raises_itself_is_left_alone(factory):
    with pytest.raises(TypeError, match="unexpected keyword argument 'speed'"):
        factory.with_overrides(speed=1).make(1)


@pytest.mark.parametrize(("limit", "warnings"), [(20, 0), (50, 1)])
def test_a_limit_that_no_episode_comes_near_is_named_once(factory, limit, warnings, caplog):
    evaluator = Evaluator({"one": replace(factory, max_episode_steps=limit)}, EvaluationSettings())
    for stream in (Stream.FOLLOWING, Stream.FINAL):
        evaluator.compare(ZERO, "one", stream, 3)
    evaluator.close()
    said = [r.getMessage() for r in caplog.records if "max_episode_steps" in r.getMessage()]
    assert len(said) == warnings
    assert all("got 50; all 3 episodes of the controller ended after 20 steps" in s for s in said)


def test_a_limit_that_cuts_episodes_off_is_named(factory, caplog):
    evaluator = Evaluator({"one": replace(factory, max_episode_steps=10)}, EvaluationSettings())
    evaluator.compare(ZERO, "one", Stream.FOLLOWING, 3)
    evaluator.close()
    assert "got 10; episodes that the environment would go on with are cut off" in caplog.text


def test_a_scenario_that_cannot_be_played_is_named(factory):
    wrong = factory.with_overrides(drfit=0.1)
    evaluator = Evaluator({"one": factory, "two": wrong}, EvaluationSettings())
    with pytest.raises(RuntimeError, match=r"scenario two: .*drfit"):
        evaluator.try_out()
    evaluator.close()
