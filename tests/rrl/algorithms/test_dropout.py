"""Networks with dropout: it is for learning, and what acts, is tested and handed over has none."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from agents import ACTION, OBSERVATION, learn, parameters
from rrl.algorithms import DDPG, SAC, TD3


class WithDropout(nn.Sequential):
    def __init__(self, in_features, out_features):
        first, last = nn.Linear(in_features, 16), nn.Linear(16, out_features)
        super().__init__(first, nn.ReLU(), nn.Dropout(0.5), last)

    def forward(self, *inputs):
        return super().forward(torch.cat(inputs, -1))


@pytest.mark.parametrize("algorithm", [TD3, SAC, DDPG])
def test_dropout_is_for_learning_alone(algorithm):
    torch.manual_seed(0)
    agent = algorithm(
        {"observation": OBSERVATION},
        ACTION,
        network=WithDropout,
        last_layer_bound=0.1,
        gamma=0.9,
    )
    seen = TensorDict({"observation": torch.ones(1, OBSERVATION)}, [1])

    @torch.no_grad()
    def act():
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            return agent.policy(seen.clone())["action"]

    before = act()
    assert all(torch.equal(act(), before) for _ in range(3))
    learn(agent, 4)
    assert not torch.equal(act(), before)
    masks = {m.training for m in agent.loss.actor_network.modules() if isinstance(m, nn.Dropout)}
    assert masks == {True}


@pytest.mark.slow
def test_a_compiled_update_drops_what_the_eager_one_drops():
    def learned(compiled):
        torch.manual_seed(0)
        agent = TD3(
            {"observation": OBSERVATION},
            ACTION,
            network=WithDropout,
            last_layer_bound=0.1,
            gamma=0.9,
            compiled=compiled,
        )
        learn(agent, 4)
        return parameters(agent)

    eager, compiled = learned(False), learned(True)
    for name, value in eager.items():
        torch.testing.assert_close(compiled[name], value, atol=1e-5, rtol=1e-4)
