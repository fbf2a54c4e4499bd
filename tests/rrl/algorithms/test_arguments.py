"""What an agent takes, and how it refuses what does not fit."""

from functools import partial

import numpy as np
import pytest
from torch import nn

from agents import ACTION, BATCH, OBSERVATION, Joining, batches, learn, make_agent
from rrl.algorithms import DDPG, SAC, TD3, TorchOptimizer

each_algorithm = pytest.mark.parametrize("algorithm", [TD3, SAC, DDPG])


@each_algorithm
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gamma", 1.0),
        ("tau", 0.0),
        ("policy_delay", 0),
        ("critic_burn_in", -1),
        ("reward_scale", 0.0),
    ],
)
def test_bad_hyperparameters_are_named(algorithm, name, value):
    with pytest.raises(ValueError, match=name):
        make_agent(algorithm, **{name: value})


@pytest.mark.parametrize(("name", "value"), [("initial_std", 0.0), ("initial_temperature", 0.0)])
def test_bad_hyperparameters_of_sac_are_named(name, value):
    with pytest.raises(ValueError, match=name):
        make_agent(SAC, **{name: value})


def without_bias(in_features, out_features):
    hidden = nn.Linear(in_features, 8)
    return Joining(hidden, nn.ReLU(), nn.Linear(8, out_features, bias=False))


@each_algorithm
def test_an_output_layer_needs_a_bias_for_a_standard_deviation_alone(algorithm):
    make = partial(algorithm, {"observation": OBSERVATION}, ACTION, network=without_bias)
    if algorithm is SAC:
        with pytest.raises(ValueError, match="network: expected an output layer with a bias"):
            make()
    else:
        assert learn(make(), 2)["loss_actor"].isfinite()


@pytest.mark.parametrize(
    ("inputs", "action_size", "message"),
    [
        ({}, 2, r"inputs: expected at least one observation entry, got \[\]"),
        ({"o": 0}, 2, r"inputs\.o: expected a whole number of at least 1, got 0"),
        ({"o": 3.5}, 2, r"inputs\.o: expected a whole number of at least 1, got 3\.5"),
        ({"o": 3}, 0, "action_size: expected a whole number of at least 1, got 0"),
    ],
)
def test_bad_sizes_are_named(inputs, action_size, message):
    with pytest.raises(ValueError, match=message):
        TD3(inputs, action_size)


def test_sizes_may_be_numpys():
    agent = TD3({"observation": np.int64(OBSERVATION)}, np.int64(ACTION))
    assert learn(agent, 2)["loss_actor"].isfinite()


def test_what_is_no_batch_of_transitions_is_named():
    agent = make_agent()
    with pytest.raises(ValueError, match=rf"batches: expected transitions \[k, B\].*\[{BATCH}\]"):
        agent.update(batches(1)[0])
    with pytest.raises(KeyError, match=r"Concatenate: expected the entry .*observation"):
        agent.update(batches(1).exclude("observation"))


@pytest.mark.parametrize("name", ["adam", "Optimizer", "lr_scheduler", "swa_utils"])
def test_what_is_no_optimizer_is_named(name):
    with pytest.raises(ValueError, match=f"name: expected an optimizer.*got '{name}'"):
        make_agent(optimizer=partial(TorchOptimizer, name=name))
