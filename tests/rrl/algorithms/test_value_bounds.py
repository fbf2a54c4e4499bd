"""Targets stay within what rewards can add up to."""

import pytest
import torch
from tensordict import TensorDict

from agents import batches, critics, make_agent, parameters
from rrl.algorithms import DDPG, SAC, TD3

GAMMA = 0.9


def an_episode_that_is_cut_off(length=12):
    """A block that tips further and further; no transition starts from where the episode ends."""
    tilt = (torch.arange(length + 1) / length).square().unsqueeze(-1)
    observation = 5.0 * tilt * torch.tensor([1.0, -1.0, 0.5, -0.5, 0.2])
    done = torch.zeros(length, 1, dtype=torch.bool)
    done[-1] = True
    return TensorDict(
        {
            "observation": observation[:-1],
            "action": torch.zeros(length, 2),
            "next": {
                "observation": observation[1:],
                "reward": -tilt[1:],
                "done": done,
                "terminated": torch.zeros_like(done),
            },
        },
        [length],
    )


def learned_from(data, **settings):
    torch.manual_seed(0)
    agent = make_agent(gamma=GAMMA, tau=0.5, critic_lr=3e-3, **settings)
    for _ in range(20):
        metrics = agent.update(data[torch.randint(len(data), (10, 12))])
    return agent, float(metrics["loss_critic"])


@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("algorithm", [TD3, DDPG, SAC])
def test_an_episode_that_is_cut_off_does_not_blow_values_up(algorithm, compiled):
    data = an_episode_that_is_cut_off()
    least = float(data["next", "reward"].min()) / (1 - GAMMA)
    _, plain = learned_from(data, algorithm=algorithm)
    assert plain > least**2  # errors larger than any value: what it is for
    agent, bounded = learned_from(data, algorithm=algorithm, value_bounds=True, compiled=compiled)
    assert bounded < least**2 / 10
    estimator = agent.loss.value_estimator
    assert float(estimator.least) == pytest.approx(least)
    assert float(estimator.most) == 0.0


def test_normalized_layers_do_not_extrapolate_so_far():
    """Why the default has no bounds."""
    data = an_episode_that_is_cut_off()
    least = float(data["next", "reward"].min()) / (1 - GAMMA)
    _, normalized = learned_from(data, algorithm=TD3, layer_norm=True)
    assert normalized < least**2 / 10


@pytest.mark.parametrize("steps", [None, 1, 3])
@pytest.mark.parametrize("algorithm", [TD3, DDPG, SAC])
def test_where_targets_are_possible_learning_is_the_same_to_the_bit(algorithm, steps):
    data = batches(10)
    reward = data["next", "reward"]
    if steps is not None:
        data["steps_to_next_obs"] = torch.full_like(reward, steps)
    learned = []
    for bounds in (False, True):
        agent = make_agent(algorithm=algorithm, gamma=GAMMA, value_bounds=bounds)
        torch.manual_seed(1)
        agent.update(data.clone())
        learned.append(parameters(agent))
    plain, bounded = learned
    assert all(torch.equal(bounded[name], value) for name, value in plain.items())
    possible = reward / (1 - GAMMA ** (steps or 1))
    estimator = agent.loss.value_estimator
    assert estimator.least == pytest.approx(float(possible.min()))
    assert estimator.most == pytest.approx(float(possible.max()))
    twin = make_agent(algorithm=algorithm, gamma=GAMMA, value_bounds=True)
    twin.load_state_dict(agent.state_dict())  # a resumed run knows what rewards there are
    assert torch.equal(twin.loss.value_estimator.least, estimator.least)


@pytest.mark.parametrize("num_critics", [2, 3])
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_entropies_count_before_the_policy_is_first_updated(num_critics, compiled):
    """Of a constant reward r and entropies of h a step, values are (r + gamma * h) / (1 - gamma)."""
    data = batches(60)
    data["next", "reward"] = torch.full_like(data["next", "reward"], -1.0)
    for name in ("done", "terminated"):
        data["next", name] = torch.zeros_like(data["next", name])
    values = {}
    for bounds in (False, True):
        agent = make_agent(
            algorithm=SAC,
            gamma=0.5,
            tau=0.5,
            critic_lr=1e-2,
            initial_temperature=2.0,
            initial_std=1.0,
            critic_burn_in=60,
            num_critics=num_critics,
            value_bounds=bounds,
            compiled=compiled,
        )
        agent.update(data.clone())
        observation, action = data["observation"][0], data["action"][0]
        values[bounds] = [
            q(observation, action).mean().item()
            for q in critics(agent.loss, "qvalue_network_params")
        ]
    assert min(values[False]) > 0.2  # more than rewards alone can add up to
    assert values[True] == pytest.approx(values[False], abs=0.1)
