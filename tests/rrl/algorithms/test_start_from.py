"""Initial weights from another agent: the same policy, and only from one that fits."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from agents import OBSERVATION, learn, make_agent
from rrl.algorithms import DDPG, SAC, TD3

ENSEMBLE = {"num_critics": 4, "target_subset": 2}


def make(algorithm, seed=0, hidden=(8, 8), **settings):
    return make_agent(algorithm, seed=seed, hidden=hidden, last_layer_bound=0.1, **settings)


def act(agent, exploration=ExplorationType.DETERMINISTIC):
    observation = torch.linspace(-1, 1, 4 * OBSERVATION).reshape(4, OBSERVATION)
    torch.manual_seed(3)
    with set_exploration_type(exploration):
        return agent.policy(TensorDict({"observation": observation}, [4]))["action"]


@pytest.mark.parametrize(
    ("algorithm", "settings"), [(TD3, {}), (TD3, ENSEMBLE), (DDPG, {}), (SAC, {}), (SAC, ENSEMBLE)]
)
def test_the_agent_acts_and_values_as_the_one_it_starts_from(algorithm, settings):
    agent, other = make(algorithm, **settings), make(algorithm, seed=7, **settings)
    learn(other, 6)
    before = act(agent)
    agent.start_from(other)
    for exploration in (ExplorationType.DETERMINISTIC, ExplorationType.RANDOM):
        assert torch.equal(act(agent, exploration), act(other, exploration))
    assert not torch.equal(before, act(agent))
    given = other.loss.state_dict()
    names = [name for name in given if "network_params" in name or name == "log_alpha"]
    assert any("target_" in name for name in names)
    for name in names:
        assert torch.equal(agent.loss.state_dict()[name], given[name]), name


@pytest.mark.parametrize("algorithm", [TD3, DDPG, SAC])
def test_the_optimizers_start_afresh_and_the_other_agent_stays_as_it_is(algorithm):
    agent, other = make(algorithm), make(algorithm, seed=7)
    learn(other, 4)
    agent.start_from(other)
    assert agent.num_updates == 0
    assert not any(buffer.any() for buffer in agent.actor_optimizer.buffers())
    before = act(other)
    learn(agent, 4)
    assert torch.equal(before, act(other))
    assert not torch.equal(act(agent), act(other))


def test_the_deviation_is_the_other_agents_whatever_the_own_initial_one():
    agent, other = make(SAC, initial_std=0.3), make(SAC, seed=7, initial_std=0.05)
    agent.start_from(other)
    assert torch.equal(act(agent, ExplorationType.RANDOM), act(other, ExplorationType.RANDOM))


def test_networks_of_another_size_are_refused():
    with pytest.raises(ValueError, match=r"expected TD3 with .* of \(8,\), got TD3 with \(4,\)"):
        make(TD3).start_from(make(TD3, hidden=(4, 8)))


@pytest.mark.parametrize("algorithm", [TD3, SAC])
def test_another_number_of_critics_is_refused(algorithm):
    agent = make(algorithm)
    before = act(agent)
    with pytest.raises(ValueError, match=r"qvalue_network_params.* of \(2, .* with \(4, "):
        agent.start_from(make(algorithm, seed=7, **ENSEMBLE))
    assert torch.equal(before, act(agent))


def test_another_algorithm_is_refused():
    with pytest.raises(ValueError, match=r"expected TD3 with .*, got SAC with"):
        make(TD3).start_from(make(SAC))


def test_a_factor_that_was_given_is_known_to_who_derives_one():
    agent = make(TD3, reward_scale=None)
    given = make(TD3, seed=7, reward_scale=10.0)
    given.is_calibrated = True
    agent.start_from(given)
    before = agent.loss.state_dict()
    values = {k: v.clone() for k, v in before.items()}
    rewards = TensorDict({"next": {"reward": torch.linspace(-50, 50, 20).unsqueeze(-1)}}, [20])
    agent.follow_rewards(rewards)
    assert float(agent.reward_scale) < 10.0
    assert any(not torch.equal(v, values[k]) for k, v in agent.loss.state_dict().items())
