"""The insertion task's mirrors: that they are the task's, and that a run uses them when told to."""

import pytest
import torch
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from rrl.algorithms.symmetric_actor import SymmetricActor
from rrl.encoders import Concatenate
from rrl.slot_random import seed_env
from rrl.trainers.configuration import build as assembly
from rrl.trainers.environment import EnvironmentFactory, Input


def composed(*overrides):
    with initialize_config_module("rrl.configs", version_base="1.3"):
        config = compose(
            "train",
            overrides=["name=run", "logger=[csv]", "env.sensing.camera_noise=null", *overrides],
        )
    return OmegaConf.to_container(config, resolve=True)


@pytest.fixture(scope="module", autouse=True)
def plain():
    from rrl.trainers.cli.compose import plain_name

    OmegaConf.register_new_resolver("plain", plain_name, replace=True)


def observations(factory, yaw, actions):
    """What the policy reads in one episode without randomness, ``[T, n]``."""
    env = factory.with_overrides(yaw_choices=[yaw], start_range=[0.0, 0.0, 0.0]).make()
    inputs = factory.read_inputs(env)
    encoder = Concatenate(inputs)
    seed_env(env, 0)
    td, rows = env.reset(), []
    for action in actions:
        td["action"] = action
        td = env.step(td)["next"]
        rows.append(encoder(*(td[key][0] for key in inputs)))
    env.close()
    return torch.stack(rows)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_mirrored_episode_goes_the_mirrored_way(seed):
    """Nearly: contacts begin a little earlier or later."""
    factory = assembly.environment(composed())
    symmetry, which = factory.symmetry(), torch.tensor([1])
    actions = 0.5 * torch.randn(30, 1, 3, generator=torch.Generator().manual_seed(seed))
    original = observations(factory, 20.0, actions)
    mirrored = observations(
        factory, -20.0, [symmetry.reflect_action(action, which) for action in actions]
    )
    expected = symmetry.reflect(original, which.expand(30))
    moves = (expected - original).abs().amax(0) > 0.5  # what the mirror changes visibly
    assert moves.sum() >= 3
    error = (mirrored - expected).abs()[:, moves].mean()
    assert error < 0.2 * (mirrored - original).abs()[:, moves].mean()


def test_controller_and_previous_action_are_mirrored_as_actions():
    factory = EnvironmentFactory(
        None,
        None,
        {"goal": Input(), "base_action": Input(), "previous_action": Input()},
        action_history=2,
        symmetries={"left_right": {"action": [-1, 2], "goal": [2, 1]}},
    )
    image = factory.symmetry().reflect(torch.arange(1.0, 9.0), torch.tensor(1))
    assert image.tolist() == [2, 1, -3, 4, -5, 6, -7, 8]
    assert EnvironmentFactory(None, None, {"goal": Input()}).symmetry() is None


def test_the_switch_decides_and_an_environment_without_mirrors_has_none():
    off = "algorithm.use_symmetries=false"
    for overrides, uses in (([], True), ([off], False), (["env.symmetries=null"], False)):
        config = composed(*overrides)
        assert not assembly.checks.problems(config)
        agent = assembly.agent(config)(inputs={"observation": 26}, action_size=3)
        assert isinstance(agent.policy.module.network, SymmetricActor) is uses
