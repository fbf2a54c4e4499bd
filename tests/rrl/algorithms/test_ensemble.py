"""Ensembles of critics: what the target and the policy see of them."""

import copy

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SACLoss, TD3Loss

from agents import BATCH, OBSERVATION, batches, critics, make_agent, parameters
from rrl.algorithms import SAC, TD3
from rrl.algorithms.ensemble import SUBSET, EnsembleSACLoss, EnsembleTD3Loss, draw_subsets
from rrl.slot_random import SlotGenerators

ENSEMBLE = {"num_critics": 5, "target_subset": 2, "layer_norm": True, "last_layer_bound": 0.1}

each_algorithm = pytest.mark.parametrize("algorithm", [TD3, SAC])


def moved(agent):
    """Let targets and online networks come apart."""
    agent.update(batches(6, agent.num_seeds, seed=3))
    return agent


def prepared(agent):
    batch = batches(1, agent.num_seeds)
    agent.prepare(batch)
    return batch[0]


def test_the_target_is_the_least_of_the_drawn_critics():
    agent = moved(make_agent(num_seeds=3, gamma=0.9, **ENSEMBLE))
    batch = prepared(agent)
    loss, info = agent.value_loss(batch)
    with torch.no_grad():
        target_actor = copy.deepcopy(agent._actor)
        agent.loss.target_actor_network_params["module", "0", "module"].data.to_module(target_actor)
        action = target_actor(batch["next", "observation"]) + batch["next", "target_smoothing"]
        inputs = batch["next", "observation"], action.clamp(-1, 1)
        following = torch.stack(
            [q(*inputs) for q in critics(agent, "target_qvalue_network_params")], -1
        )
        chosen = batch["next", SUBSET]
        least = following[chosen].reshape(3, BATCH, 2).amin(-1)
        target = (
            batch["next", "reward"].squeeze(-1)
            + 0.9 * ~batch["next", "terminated"].squeeze(-1) * least
        )
        now = torch.stack(
            [
                q(batch["observation"], batch["action"])
                for q in critics(agent, "qvalue_network_params")
            ]
        )
    torch.testing.assert_close(loss, (now - target).square().sum(0))
    torch.testing.assert_close(info["target_value"], target.mean(-1))


def test_the_policy_climbs_the_mean_of_all():
    agent = moved(make_agent(num_seeds=2, **ENSEMBLE))
    batch = prepared(agent)
    action = agent._actor(batch["observation"])
    values = torch.stack(
        [q(batch["observation"], action) for q in critics(agent, "qvalue_network_params")]
    )
    torch.testing.assert_close(agent.actor_loss(batch)[0], -values.mean(0))


def test_sacs_target_is_the_least_of_the_drawn_critics_and_its_policy_climbs_the_mean_of_all():
    agent = moved(make_agent(SAC, num_seeds=3, **ENSEMBLE))
    batch = prepared(agent)
    agent._set_temperature(batch)
    dist = agent.loss.actor_network.get_dist(batch["next"].clone())
    action, log_prob = dist.rsample_and_log_prob()
    target_critics = critics(agent, "target_qvalue_network_params")
    following = torch.stack([q(batch["next", "observation"], action) for q in target_critics], -1)
    least = following[batch["next", SUBSET]].reshape(3, BATCH, 2).amin(-1)
    worth = agent.loss.qvalue_v2_loss(batch)[1]["next_state_value"]
    torch.testing.assert_close(worth, (least - log_prob).detach())
    action, log_prob = agent.loss.actor_network.get_dist(batch.clone()).rsample_and_log_prob()
    values = torch.stack(
        [q(batch["observation"], action) for q in critics(agent, "qvalue_network_params")]
    )
    torch.testing.assert_close(agent.loss.actor_loss(batch.clone())[0], log_prob - values.mean(0))


def test_sac_of_two_critics_with_both_in_the_target_is_torchrls():
    assert type(make_agent(SAC).loss) is SACLoss
    agent = moved(make_agent(SAC, num_seeds=2, num_critics=2, target_subset=1))
    batch = prepared(agent)
    del batch["next", SUBSET]  # all of them
    agent._set_temperature(batch)
    mine, torchrls = (
        kind.qvalue_v2_loss(agent.loss, batch.clone()) for kind in (EnsembleSACLoss, SACLoss)
    )
    torch.testing.assert_close(mine[0], torchrls[0])
    torch.testing.assert_close(mine[1]["td_error"], torchrls[1]["td_error"])


def test_two_critics_with_both_in_the_target_have_torchrls_losses_and_gradients():
    agent = moved(make_agent(num_seeds=2, last_layer_bound=0.1))
    batch = prepared(agent)
    params = [*agent._critic_params, *agent._actor_params]
    for method in ("value_loss", "actor_loss"):
        mine, torchrls = (
            getattr(agent.loss, method)(batch),
            getattr(TD3Loss, method)(agent.loss, batch),
        )
        torch.testing.assert_close(mine[0], torchrls[0])
        gradients = [
            torch.autograd.grad(loss.sum(), params, allow_unused=True)
            for loss, _ in (mine, torchrls)
        ]
        for one, other in zip(*gradients, strict=True):
            assert (one is None) == (other is None)
            if one is not None:
                torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)
    assert SUBSET not in batch["next"]
    assert type(make_agent(num_critics=2, target_subset=1).loss) is EnsembleTD3Loss


def test_subsets_have_their_size_and_every_critic_its_turn():
    subsets = draw_subsets(SlotGenerators(0, 3), 400, 5, 2)
    assert subsets.shape == (400, 3, 5)
    assert (subsets.sum(-1) == 2).all()
    torch.testing.assert_close(
        subsets.float().mean((0, 1)), torch.full((5,), 0.4), atol=0.05, rtol=0.0
    )


def test_a_seed_draws_its_own_subsets():
    stack, alone = (
        draw_subsets(SlotGenerators(4, 3), 20, 6, 3),
        draw_subsets(SlotGenerators(5, 1), 20, 6, 3),
    )
    assert torch.equal(stack[:, 1], alone[:, 0])
    assert not torch.equal(stack[:, 0], stack[:, 1])


@each_algorithm
def test_a_seed_learns_in_a_stack_what_it_learns_alone(algorithm):
    stack, alone = (
        make_agent(algorithm, num_seeds=3, seed=5, **ENSEMBLE),
        make_agent(algorithm, num_seeds=1, seed=6, **ENSEMBLE),
    )
    data = batches(6, 3)
    stack.update(data.clone())
    alone.update(data[:, 1:2].clone())
    for mine, other in zip(
        stack.policy_of(1).parameters(), alone.policy_of(0).parameters(), strict=True
    ):
        torch.testing.assert_close(mine, other, rtol=1e-4, atol=1e-5)


@each_algorithm
def test_state_dict_restores_the_next_subsets(algorithm):
    agent, other = (make_agent(algorithm, num_seeds=2, seed=seed, **ENSEMBLE) for seed in (0, 7))
    agent.update(batches(3, 2))
    other.load_state_dict(copy.deepcopy(agent.state_dict()))
    for learner in (agent, other):
        learner.update(batches(3, 2, seed=1))
    for name, value in parameters(agent).items():
        assert torch.equal(value, parameters(other)[name]), name


@each_algorithm
def test_the_global_generator_is_left_alone(algorithm):
    agent, before = make_agent(algorithm, num_seeds=2, **ENSEMBLE), torch.get_rng_state()
    agent.update(batches(3, 2))
    assert torch.equal(before, torch.get_rng_state())


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the compiler warns of its own doings
@pytest.mark.parametrize(("algorithm", "more"), [(TD3, {"residual_penalty": 0.1}), (SAC, {})])
def test_the_compiled_update_equals_the_eager_one(algorithm, more):
    eager, compiled = (
        make_agent(algorithm, num_seeds=2, **ENSEMBLE, **more, compiled=c) for c in (False, True)
    )
    for learner in (eager, compiled):
        learner.update(batches(10, 2))
    for name, value in parameters(eager).items():
        torch.testing.assert_close(parameters(compiled)[name], value, rtol=1e-4, atol=1e-5)


def test_the_penalty_makes_residuals_small():
    observation = TensorDict({"observation": torch.randn(1, 50, OBSERVATION)}, [1, 50])
    sizes = []
    for penalty in (0.0, 100.0):
        agent = make_agent(last_layer_bound=0.5, residual_penalty=penalty, actor_lr=1e-2)
        metrics = agent.update(batches(40, 1))
        sizes.append(agent.policy(observation.clone())["action"].square().mean().item())
        assert ("residual_square" in metrics) is (penalty > 0)
    assert sizes[1] < sizes[0] / 10
