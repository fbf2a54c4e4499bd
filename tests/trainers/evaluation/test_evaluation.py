"""Evaluation: frozen, paired, and the zero residual is the controller bit for bit."""

from functools import partial

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import TransformedEnv

from rrl.controllers import ProportionalController
from rrl.envs import InsertionEnv
from rrl.trainers.environment import EnvironmentFactory, Input
from rrl.trainers.evaluation.episodes import Comparison, run_episodes, zero_residual
from rrl.transforms import ControlNoise
from toy_envs import PointMass


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
    for name, peak in residual.peaks.items():
        assert (peak == alone.peaks[name]).all()


def test_an_unknown_input_names_the_choices(factory):
    wrong = EnvironmentFactory(
        base=factory.base, controller=factory.controller, inputs={"position": Input()}
    )
    with pytest.raises(KeyError, match=r"'position'.*end_effector_position"):
        wrong.make(1)


def test_a_scale_of_the_wrong_length_is_named(factory):
    wrong = EnvironmentFactory(
        base=factory.base,
        controller=factory.controller,
        inputs={"goal": Input(scale=[1.0, 2.0, 3.0])},
    )
    with pytest.raises(ValueError, match="'goal' has 2 numbers"):
        wrong.make(1)
