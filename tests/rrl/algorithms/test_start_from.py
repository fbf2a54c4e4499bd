"""Initial weights from another agent: the same policy in every seed, and only from one that fits."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from rrl.algorithms import DDPG, SAC, TD3


def make(algorithm, num_seeds, seed=0, hidden=(8, 8)):
    return algorithm(
        {"observation": 5}, 2, num_seeds=num_seeds, seed=seed, hidden=hidden, last_layer_bound=0.1
    )


def act(agent, k):
    td = TensorDict({"observation": torch.linspace(-1, 1, 20).reshape(4, 5)}, [4])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        return agent.policy_of(k)(td)["action"]


@pytest.mark.parametrize("algorithm", [TD3, DDPG, SAC])
def test_every_seed_starts_from_the_chosen_one(algorithm):
    agent, other = make(algorithm, 2), make(algorithm, 3, seed=7)
    before = act(agent, 0)
    agent.start_from(other, 2)
    for k in range(2):
        assert torch.equal(act(agent, k), act(other, 2))
    assert not torch.equal(before, act(agent, 0))
    targets = {n: v for n, v in agent.loss.state_dict().items() if "target_" in n and v.ndim >= 3}
    assert targets
    for name, value in targets.items():
        assert torch.equal(
            value, other.loss.state_dict()[name].narrow(-3, 2, 1).expand_as(value)
        ), name


def test_networks_of_another_size_are_refused():
    with pytest.raises(
        ValueError, match=r"expected a TD3 with .* of \(5, 8\), got a TD3 with \(5, 4\)"
    ):
        make(TD3, 1).start_from(make(TD3, 1, hidden=(4, 8)), 0)
