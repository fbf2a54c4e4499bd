"""Ensembles of critics: what target and policy see of them."""

import copy

import pytest
import torch

from agents import ACTION, BATCH, batches, critics, learn, make_agent, parameters
from ensembles import TORCHRL, each_loss, make_loss
from rrl.algorithms import SAC, TD3, EnsembleSACLoss, EnsembleTD3Loss
from rrl.keys import OBSERVATION as FEATURES

ENSEMBLE = {"num_critics": 5, "target_subset": 2, "layer_norm": True, "last_layer_bound": 0.1}

each_algorithm = pytest.mark.parametrize("algorithm", [TD3, SAC])


def drawn_critics(count, size):
    """The next critics in the target, from torch's generator."""
    return torch.rand(count).argsort()[:size]


def test_the_target_is_the_least_of_the_drawn_critics():
    agent = make_agent(gamma=0.9, **ENSEMBLE)
    learn(agent, 6, seed=3)
    batch = agent.readings.prepare(batches(1))[0]
    torch.manual_seed(2)
    loss, info = agent.value_loss(batch)
    torch.manual_seed(2)
    noise = (0.2 * torch.randn(BATCH, ACTION)).clamp(-0.5, 0.5)
    drawn = drawn_critics(5, 2)
    with torch.no_grad():
        following = batch["next"].select(FEATURES)
        with agent.loss.target_actor_network_params.data.to_module(agent.loss.actor_network):
            action = agent.loss.actor_network(following)["action"] + noise
        inputs = batch["next", FEATURES], action.clamp(-1, 1)
        values = [q(*inputs) for q in critics(agent.loss, "target_qvalue_network_params")]
        least = torch.stack(values)[drawn].amin(0)
        goes_on = ~batch["next", "terminated"].squeeze(-1)
        target = batch["next", "reward"].squeeze(-1) + 0.9 * goes_on * least
        now = [
            q(batch[FEATURES], batch["action"])
            for q in critics(agent.loss, "qvalue_network_params")
        ]
    expected = (torch.stack(now) - target).square().sum(0).mean()
    torch.testing.assert_close(loss, expected)
    torch.testing.assert_close(info["target_value"], target.mean())


@pytest.mark.parametrize(
    ("policy_value", "climbed"),
    [("mean", lambda q: q.mean(0)), ("first", lambda q: q[0]), ("least", lambda q: q.amin(0))],
)
@each_loss
def test_the_policy_climbs_the_critics_that_it_is_told_to(kind, policy_value, climbed):
    loss = make_loss(kind, num_critics=5, policy_value=policy_value, reduction="none")
    batch = batches(1)[0]
    torch.manual_seed(2)
    value, _ = loss.actor_loss(batch.clone())
    torch.manual_seed(2)
    if kind is EnsembleTD3Loss:
        action, effort = loss.actor_network(batch.clone())["action"], 0.0
    else:
        density = loss.actor_network.get_dist(batch.clone())
        action = density.rsample()
        effort = 0.5 * density.log_prob(action)
    values = [q(batch["observation"], action) for q in critics(loss, "qvalue_network_params")]
    expected = effort - climbed(torch.stack(values))
    torch.testing.assert_close(value, expected, rtol=1e-4, atol=1e-5)


def test_sacs_target_is_the_least_of_the_drawn_critics_with_the_entropy():
    loss, batch = make_loss(EnsembleSACLoss, num_critics=5, target_subset=3), batches(1)[0]
    torch.manual_seed(2)
    worth = loss.qvalue_v2_loss(batch.clone())[1]["next_state_value"]
    torch.manual_seed(2)
    with torch.no_grad():
        density = loss.actor_network.get_dist(batch["next"].select("observation"))
        action = density.rsample()
        drawn = drawn_critics(5, 3)
        target_critics = critics(loss, "target_qvalue_network_params")
        values = [q(batch["next", "observation"], action) for q in target_critics]
        least = torch.stack(values)[drawn].amin(0)
        expected = least - 0.5 * density.log_prob(action)
    torch.testing.assert_close(worth, expected, rtol=1e-4, atol=1e-5)


@each_loss
def test_every_critic_has_its_turn_in_the_target(kind):
    """Critics worth 0 to 4 everywhere: the target is the least of two that are drawn."""
    loss, batch = make_loss(kind, num_critics=5, target_subset=2), batches(1)[0]
    with torch.no_grad():
        for value in loss.target_qvalue_network_params.values(True, True):
            value.zero_()
        loss.target_qvalue_network_params["module", "2", "bias"].copy_(torch.arange(5.0)[:, None])
    following = batch["next"].select("observation").set("action", batch["action"])
    least = torch.cat([loss._least_target(following).unique() for _ in range(2000)])
    assert least.numel() == 2000  # one draw for the whole batch
    shares = least.long().bincount(minlength=5) / 2000
    expected = torch.tensor([0.4, 0.3, 0.2, 0.1, 0.0])
    torch.testing.assert_close(shares, expected, atol=0.05, rtol=0.0)


@each_algorithm
def test_two_critics_with_both_in_the_target_make_torchrls_own_loss(algorithm):
    ensemble = EnsembleTD3Loss if algorithm is TD3 else EnsembleSACLoss
    assert type(make_agent(algorithm).loss) is TORCHRL[ensemble]
    for settings in ({"num_critics": 2, "target_subset": 1}, ENSEMBLE):
        loss = make_agent(algorithm, **settings).loss
        assert type(loss) is ensemble
        assert loss.policy_value == "mean"
        assert loss.qvalue_network_params.shape == (settings["num_critics"],)


@each_algorithm
def test_subsets_come_from_torchs_generator(algorithm):
    one, same, other = (make_agent(algorithm, **ENSEMBLE) for _ in range(3))
    data = batches(3)
    for seed, agent in ((1, one), (1, same), (2, other)):
        torch.manual_seed(seed)
        agent.update(data.clone())
    for name, value in parameters(one).items():
        assert torch.equal(value, parameters(same)[name]), name
    assert any(not torch.equal(v, parameters(other)[name]) for name, v in parameters(one).items())


@each_algorithm
def test_state_dict_restores_the_next_update(algorithm):
    agent, other = (make_agent(algorithm, seed=seed, **ENSEMBLE) for seed in (0, 7))
    learn(agent, 3)
    other.load_state_dict(copy.deepcopy(agent.state_dict()))
    for learner in (agent, other):
        learn(learner, 3, seed=1)
    for name, value in parameters(agent).items():
        assert torch.equal(value, parameters(other)[name]), name


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the compiler warns of its own doings
@each_algorithm
def test_the_compiled_update_equals_the_eager_one(algorithm):
    eager, compiled = (make_agent(algorithm, **ENSEMBLE, compiled=c) for c in (False, True))
    for learner in (eager, compiled):
        learn(learner, 10)
    for name, value in parameters(eager).items():
        torch.testing.assert_close(parameters(compiled)[name], value, rtol=1e-4, atol=1e-5)
