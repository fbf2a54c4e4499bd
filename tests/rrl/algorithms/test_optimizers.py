"""What an optimizer keeps when a run goes on, and what it is told anew."""

import copy
from functools import partial

import pytest
import torch

from agents import learn, make_agent, parameters
from rrl.algorithms import Adam, TorchOptimizer

OPTIMIZERS = {"ours": Adam, "torch's": partial(TorchOptimizer, name="AdamW", weight_decay=0.0)}


@pytest.mark.parametrize("optimizer", OPTIMIZERS.values(), ids=OPTIMIZERS)
def test_a_learner_that_goes_on_has_its_moments_and_the_new_learning_rate(optimizer):
    def make(lr):
        return make_agent(optimizer=optimizer, critic_lr=lr, actor_lr=lr)

    before, same, slow = make(1e-3), make(1e-3), make(1e-9)
    learn(before, 2)
    for agent in (same, slow):
        agent.load_state_dict(copy.deepcopy(before.state_dict()))
        learn(agent, 2, seed=1)
    saved = {name: value.clone() for name, value in parameters(before).items()}
    learn(before, 2, seed=1)
    for name, value in parameters(before).items():
        assert torch.equal(parameters(same)[name], value), name
        if "target" not in name and name.startswith("loss."):
            torch.testing.assert_close(parameters(slow)[name], saved[name], rtol=0, atol=1e-6)


@pytest.mark.parametrize("optimizer", OPTIMIZERS.values(), ids=OPTIMIZERS)
def test_the_moments_of_a_learner_that_was_moved_go_with_its_parameters(optimizer):
    agent = make_agent(optimizer=optimizer)
    learn(agent, 2)
    agent.double()  # as to another device: makes new tensors of another kind
    before = {name: value.clone() for name, value in parameters(agent).items()}
    learn(agent, 2, seed=1)
    for name, value in parameters(agent).items():
        assert value.dtype == before[name].dtype == torch.float64, name
    assert any(not torch.equal(value, before[name]) for name, value in parameters(agent).items())


@pytest.mark.parametrize("goes_on", [False, True])
def test_an_attempt_to_compile_leaves_no_step_in_the_moments(goes_on):
    """An optimizer of torch cannot be compiled, and keeps its moments beside the tensors."""
    make = partial(make_agent, optimizer=OPTIMIZERS["torch's"], last_layer_bound=0.1)
    eager, compiled = make(), make(compiled=True)
    if goes_on:
        learn(eager, 2)
        compiled.load_state_dict(copy.deepcopy(eager.state_dict()))
    learn(eager, 2, seed=1)
    with pytest.warns(UserWarning, match="the update is not compiled"):
        learn(compiled, 2, seed=1)
    learn(eager, 2, seed=2)
    learn(compiled, 2, seed=2)
    for name, value in parameters(eager).items():
        assert torch.equal(parameters(compiled)[name], value), name
