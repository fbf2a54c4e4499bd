"""Networks that anybody brings: any order of layers, buffers, frozen parts; one output layer."""

import copy

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from agents import ACTION, OBSERVATION, learn, make_agent
from rrl.algorithms import DDPG, SAC, TD3, mlp
from rrl.algorithms.networks import output_layer

each_algorithm = pytest.mark.parametrize("algorithm", [TD3, SAC, DDPG])


class HeadFirst(nn.Module):
    """Registers its output layer before the others, and drops out."""

    def __init__(self, in_features, out_features):
        super().__init__()
        self.head = nn.Linear(8, out_features)
        self.body = nn.Sequential(nn.Linear(in_features, 8), nn.ReLU(), nn.Dropout(0.5))

    def forward(self, *inputs):
        return self.head(self.body(torch.cat(inputs, -1)))


@each_algorithm
@pytest.mark.parametrize("network", [mlp, HeadFirst])
def test_an_untrained_residual_is_exactly_zero(algorithm, network):
    agent = make_agent(algorithm, network=network)
    td = TensorDict({"observation": torch.randn(2, OBSERVATION)}, [2])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(agent.policy(td)["action"], torch.zeros(2, ACTION))
    if algorithm is SAC:
        torch.testing.assert_close(td["_scale"], torch.full((2, ACTION), 0.3))


@pytest.mark.parametrize("network", [mlp, HeadFirst])
def test_nothing_is_drawn_to_find_the_output_layer(network):
    torch.manual_seed(0)
    made = network(3, 2)
    state, weights = torch.get_rng_state(), copy.deepcopy(made.state_dict())
    assert output_layer(made, 3) == {mlp: "4", HeadFirst: "head"}[network]
    assert torch.equal(torch.get_rng_state(), state)
    assert all(torch.equal(value, weights[key]) for key, value in made.state_dict().items())
    assert all(module.training for module in made.modules())


class TwoHeads(nn.Module):
    """A layer for each half of the output."""

    def __init__(self, in_features, out_features):
        super().__init__()
        self.body = nn.Linear(in_features, 8)
        self.heads = nn.ModuleList(
            nn.Linear(8, size) for size in (out_features // 2, -(-out_features // 2)) if size
        )

    def forward(self, *inputs):
        hidden = self.body(torch.cat(inputs, -1)).relu()
        return torch.cat([head(hidden) for head in self.heads], -1)


@each_algorithm
def test_an_output_of_several_layers_is_refused(algorithm):
    with pytest.raises(ValueError, match="network: expected one linear output layer"):
        make_agent(algorithm, network=TwoHeads)


class Steady(nn.Module):
    """Keeps a running mean of what it reads, random features that stay, and a frozen layer."""

    def __init__(self, in_features, out_features):
        super().__init__()
        self.norm = nn.BatchNorm1d(in_features)
        self.register_buffer("frequencies", torch.randn(in_features, 8))
        self.frozen = nn.Linear(8, 8).requires_grad_(False)
        self.head = nn.Linear(8, out_features)

    def forward(self, *inputs):
        read = self.norm(torch.cat(inputs, -1))
        return self.head(self.frozen((read @ self.frequencies).sin()))


@each_algorithm
@pytest.mark.parametrize("moved", [False, True])
def test_a_network_may_have_buffers_and_frozen_layers(algorithm, moved):
    agent = make_agent(algorithm, network=Steady, last_layer_bound=0.1)
    if moved:
        agent.double().float()  # as to another device and back: makes new tensors
    before = {name: value.clone() for name, value in agent.policy.state_dict().items()}
    learn(agent, 4)
    after = agent.policy.state_dict()
    moves = {name for name, value in after.items() if not torch.equal(value, before[name])}
    still = [name for name in after if "frozen" in name or "frequencies" in name]
    assert len(still) == 3 and not moves & set(still)
    assert sum("norm.running" in name for name in moves) == 2
    assert sum("head" in name for name in moves) == 2
    for name, value in agent.loss.state_dict().items():  # what learns is what acts
        if name.startswith("actor_network_params") and "running_mean" in name:
            assert any(torch.equal(value, after[other]) for other in moves if "mean" in other)
