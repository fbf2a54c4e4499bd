"""What is derived from the environment and from first transitions, and what it is good for."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torch.nn.functional import mse_loss

from agents import BATCH, OBSERVATION, Joining, batches, learn, make_agent, parameters
from rrl.algorithms import DDPG, SAC, TD3, mlp
from rrl.algorithms.calibration import (
    VALUE_SPREAD,
    discount,
    reward_factor,
    warmup_length,
)
from rrl.encoders.concatenate import Concatenate, standardization
from rrl.inputs import Input
from rrl.n_step import STEPS


@pytest.mark.parametrize("factor", [1e-4, 1e6])
def test_rewards_of_any_size_are_learned_from_alike(factor):
    agents = []
    for size in (1.0, factor):
        agent, data = make_agent(reward_scale=None, last_layer_bound=0.1), batches(4)
        data["next", "reward"] *= size
        agent.calibrate(data.reshape(-1))
        torch.manual_seed(0)
        agent.update(data)
        agents.append(agent)
    for name, value in agents[0].loss.state_dict().items():
        torch.testing.assert_close(agents[1].loss.state_dict()[name], value, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("algorithm", "settings"), [(TD3, {}), (TD3, {"num_critics": 5}), (SAC, {}), (DDPG, {})]
)
def test_rewards_that_grow_are_scaled_anew_and_values_keep_their_meaning(algorithm, settings):
    still = {"critic_lr": 1e-12, "tau": 1e-12}  # only the scale moves
    agent = make_agent(algorithm, reward_scale=None, last_layer_bound=0.1, **still, **settings)
    data = batches(64)
    agent.calibrate(data.reshape(-1))
    scale, values = float(agent.reward_scale), _values(agent, data)
    agent.follow_rewards(data.reshape(-1))
    assert float(agent.reward_scale) == scale  # nothing has grown
    data["next", "reward"] *= 20
    agent.follow_rewards(data.reshape(-1))
    agent.update(data)
    assert float(agent.reward_scale) == pytest.approx(scale / 20)
    torch.testing.assert_close(_values(agent, data) * 20, values)
    agent.follow_rewards(batches(64).reshape(-1))  # the largest rewards count
    assert float(agent.reward_scale) == pytest.approx(scale / 20)


@pytest.mark.parametrize("make", [TD3, SAC, DDPG])
def test_a_successor_of_a_run_with_sums_of_rewards_keeps_the_scale(make):
    agent = make_agent(make, reward_scale=None, last_layer_bound=0.1)
    heir = make_agent(make, reward_scale=None)
    data = batches(64)
    data["next", "reward"] *= 1 + agent.gamma + agent.gamma**2
    data[STEPS] = torch.full((64, BATCH, 1), 3.0)
    agent.calibrate(data.reshape(-1))
    heir.start_from(agent)
    scale = float(agent.reward_scale)
    agent.follow_rewards(data.reshape(-1))
    heir.follow_rewards(data.reshape(-1))
    assert float(agent.reward_scale) == float(heir.reward_scale) == scale


def _values(agent, data):
    """Values of critics and targets, ``[n, k, B]``."""
    loss, name = agent.loss, "value_network" if isinstance(agent, DDPG) else "qvalue_network"
    network, found = getattr(loss, name), []
    for params in (getattr(loss, f"{name}_params"), getattr(loss, f"target_{name}_params")):
        for one in [params] if isinstance(agent, DDPG) else params.unbind(0):
            with one.data.to_module(network):
                found.append(network(agent.readings.prepare(data))["state_action_value"])
    return torch.stack(found).detach()


def test_a_scale_that_was_given_stays():
    agent = make_agent(reward_scale=2.0)
    data = batches(4)
    agent.calibrate(data.reshape(-1))
    data["next", "reward"] *= 1000
    agent.follow_rewards(data.reshape(-1))
    assert float(agent.reward_scale) == 2.0


@pytest.mark.parametrize("offset", [0.0, 0.5, -0.5])
def test_values_get_their_spread(offset):
    rewards = torch.randn(10_000, generator=torch.Generator().manual_seed(0)) + offset
    gamma = 0.97
    factor = reward_factor(rewards, gamma)
    assert factor * rewards.std() / (1 - gamma) == pytest.approx(VALUE_SPREAD, rel=0.01)


def without_rewards():
    data = batches(64).reshape(-1)
    data["next", "reward"] *= 0
    return data


def test_rewards_of_zero_say_nothing():
    assert reward_factor(torch.zeros(100), 0.9) is None
    agent, data = make_agent(reward_scale=None), batches(64).reshape(-1)
    data["next", "reward"] *= 0.01
    agent.calibrate(data)
    scale = float(agent.reward_scale)
    assert scale > 1
    agent.follow_rewards(without_rewards())
    assert float(agent.reward_scale) == scale


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_the_first_reward_decides_however_late_it_comes(size):
    agent = make_agent(reward_scale=None)
    agent.calibrate(without_rewards())
    assert float(agent.reward_scale) == 1.0
    again = make_agent(reward_scale=None)
    again.load_state_dict(agent.state_dict())
    for learner in (agent, again):  # after a resumption too
        data = batches(64).reshape(-1)
        data["next", "reward"] *= size
        learner.follow_rewards(data)
        expected = reward_factor(data["next", "reward"].flatten(), learner.gamma)
        assert float(learner.reward_scale) == pytest.approx(expected)


def nested(in_features, out_features):
    """Its last layer is called 1, and one of those before it 0.1."""
    body = nn.Sequential(nn.Linear(in_features, 8), nn.Linear(8, 8), nn.ReLU())
    return Joining(body, nn.Linear(8, out_features))


@pytest.mark.parametrize("network", [partial(mlp, hidden=[]), nested])
def test_the_last_layer_alone_is_scaled(network):
    agent = make_agent(reward_scale=None, last_layer_bound=0.1, network=network)
    data = batches(64)
    agent.calibrate(data.reshape(-1))
    values = _values(agent, data)
    data["next", "reward"] *= 20
    agent.follow_rewards(data.reshape(-1))
    torch.testing.assert_close(_values(agent, data) * 20, values)


def test_a_constant_reward_does_not_explode():
    assert 0 < reward_factor(torch.full((100,), 10.0), 0.99) < 1.0


def test_sums_of_rewards_count_as_one_each():
    one = reward_factor(torch.randn(1000, generator=torch.Generator().manual_seed(0)), 0.9)
    summed = torch.randn(1000, generator=torch.Generator().manual_seed(0)) * (1 + 0.9 + 0.81)
    assert reward_factor(summed, 0.9, n_step=3) == pytest.approx(one)


def test_the_discount_looks_two_thirds_of_an_episode_ahead():
    assert discount(50) == pytest.approx(0.97)
    assert discount(1) == 0.9
    assert discount(10**6) == 0.995


@pytest.mark.parametrize("episode_steps", [1, 50, 200, 10**5])
@pytest.mark.parametrize("total_steps", [50, 100, 3000, 10**6])
def test_the_warm_up_is_a_small_part_of_whole_rounds(episode_steps, total_steps):
    steps = warmup_length(episode_steps, total_steps, 50)
    assert steps % 50 == 0
    assert steps <= max(total_steps / 10, 50)
    assert steps < total_steps
    if total_steps == 10**6 and episode_steps <= 200:
        assert steps == max(300, 5 * episode_steps)


def test_a_number_that_does_not_move_is_not_blown_up():
    values = torch.randn(1000, 3) * torch.tensor([1.0, 2.0, 0.0]) + torch.tensor([0.0, 5.0, 9.0])
    loc, scale = standardization(values)
    torch.testing.assert_close(loc, values.mean(0))
    torch.testing.assert_close(scale[:2], 1 / values.std(0)[:2], rtol=0.01, atol=0)
    assert 1 < scale[2] < 100
    assert standardization(torch.full((10, 2), 7.0))[1].tolist() == [1.0, 1.0]


def test_an_entry_that_stood_still_is_not_clipped():
    encoder = Concatenate({"force": Input(shape=(2,)), "place": Input(shape=(2,))})
    place = torch.randn(300, 2) * torch.tensor([1.0, 0.0])
    encoder.calibrate(torch.full((300, 2), 0.5), place)
    force = torch.tensor([[20.5, 50.5]])
    assert encoder(force, 1e3 * torch.ones(1, 2)).tolist() == [[20.0, 50.0, 10.0, 10.0]]


def test_only_entries_without_center_and_scale_are_standardized():
    inputs = {"far": Input(shape=(2,)), "by_hand": Input(scale=3.0, shape=(1,))}
    torch.manual_seed(0)
    agent = TD3(inputs, 1, last_layer_bound=0.1)
    n = 500
    data = TensorDict(
        {
            "far": torch.randn(n, 2) * 50 + 1000,
            "by_hand": torch.randn(n, 1) + 5,
            "action": torch.zeros(n, 1),
            "next": {"reward": torch.randn(n, 1)},
        },
        [n],
    )
    told = agent.calibrate(data)
    assert list(told["inputs"]) == ["far"]
    features = agent.encoder(data["far"], data["by_hand"])
    torch.testing.assert_close(features[:, :2].mean(0), torch.zeros(2), atol=1e-3, rtol=0)
    torch.testing.assert_close(features[:, :2].std(0), torch.ones(2), atol=0.01, rtol=0)
    assert torch.equal(features[:, 2], 3 * data["by_hand"][:, 0])
    assert agent.encoder(torch.full((1, 2), 1e9), torch.zeros(1, 1)).abs().max() <= 10


def test_no_discount_without_an_episodes_length():
    with pytest.raises(ValueError, match="episode_steps"):
        make_agent(gamma=None)
    assert make_agent(gamma=None, episode_steps=50).gamma == pytest.approx(0.97)


@pytest.mark.parametrize("algorithm", [TD3, DDPG, SAC])
def test_a_checkpoint_and_a_successor_know_what_was_derived(algorithm):
    agent = make_agent(algorithm, reward_scale=None, last_layer_bound=0.1)
    agent.inputs = {"observation": Input(shape=(OBSERVATION,))}
    data = batches(3)
    data["observation"] = data["observation"] * 7 + 3
    agent.calibrate(data.reshape(-1))
    for other in (make_agent(algorithm, seed=5, reward_scale=None) for _ in range(1)):
        other.load_state_dict(agent.state_dict())
        assert other.is_calibrated
        assert torch.equal(other.reward_scale, agent.reward_scale)
        assert torch.equal(other.encoder.scale, agent.encoder.scale)
    heir = make_agent(algorithm, seed=5, reward_scale=None)
    heir.start_from(agent)
    assert torch.equal(heir.reward_scale, agent.reward_scale)
    td = TensorDict({"observation": torch.randn(4, OBSERVATION)}, [4])
    with torch.no_grad():
        torch.manual_seed(0)
        expected = agent.policy(td.clone())["action"]
        torch.manual_seed(0)
        assert torch.equal(heir.policy(td.clone())["action"], expected)


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("algorithm", [TD3, DDPG, SAC])
def test_a_heavy_penalty_keeps_the_residual_small(algorithm, compiled):
    def size(penalty):
        agent = make_agent(
            algorithm, last_layer_bound=0.5, residual_penalty=penalty, compiled=compiled
        )
        for seed in range(20):
            learn(agent, 4, seed)
        action = agent._residual(agent.readings.prepare(batches(1))[0])
        return mse_loss(action, torch.zeros_like(action))

    assert size(100.0) < 0.3 * size(0.0)


def test_without_a_penalty_nothing_changes():
    agents = [make_agent(last_layer_bound=0.1, **given) for given in ({}, {"residual_penalty": 0})]
    for agent in agents:
        learn(agent, 6)
    one, other = map(parameters, agents)
    assert all(torch.equal(one[name], other[name]) for name in one)
