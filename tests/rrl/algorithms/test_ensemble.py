"""Ensembles of critics under TD3: what the target and the policy see of them."""

import copy

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import TD3Loss

from agents import BATCH, OBSERVATION, batches, critics, make_agent, parameters
from rrl.algorithms.ensemble import SUBSET, EnsembleTD3Loss, draw_subsets
from rrl.random import SlotGenerators

ENSEMBLE = {"num_critics": 5, "target_subset": 2, "layer_norm": True, "last_layer_bound": 0.1}


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
        following = torch.stack([q(*inputs) for q in critics(agent, "target_qvalue_network_params")], -1)
        chosen = batch["next", SUBSET]
        least = following[chosen].reshape(3, BATCH, 2).amin(-1)
        target = batch["next", "reward"].squeeze(-1) + 0.9 * ~batch["next", "terminated"].squeeze(-1) * least
        now = torch.stack([q(batch["observation"], batch["action"]) for q in critics(agent, "qvalue_network_params")])
    torch.testing.assert_close(loss, (now - target).square().sum(0))
    torch.testing.assert_close(info["target_value"], target.mean(-1))


def test_the_policy_climbs_the_mean_of_all():
    agent = moved(make_agent(num_seeds=2, **ENSEMBLE))
    batch = prepared(agent)
    action = agent._actor(batch["observation"])
    values = torch.stack([q(batch["observation"], action) for q in critics(agent, "qvalue_network_params")])
    torch.testing.assert_close(agent.actor_loss(batch)[0], -values.mean(0))


def test_two_critics_with_both_in_the_target_have_torchrls_losses_and_gradients():
    agent = moved(make_agent(num_seeds=2, last_layer_bound=0.1))
    batch = prepared(agent)
    params = [*agent._critic_params, *agent._actor_params]
    for method in ("value_loss", "actor_loss"):
        mine, torchrls = getattr(agent.loss, method)(batch), getattr(TD3Loss, method)(agent.loss, batch)
        torch.testing.assert_close(mine[0], torchrls[0])
        gradients = [torch.autograd.grad(loss.sum(), params, allow_unused=True) for loss, _ in (mine, torchrls)]
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
    torch.testing.assert_close(subsets.float().mean((0, 1)), torch.full((5,), 0.4), atol=0.05, rtol=0.0)


def test_a_seed_draws_its_own_subsets():
    stack, alone = draw_subsets(SlotGenerators(4, 3), 20, 6, 3), draw_subsets(SlotGenerators(5, 1), 20, 6, 3)
    assert torch.equal(stack[:, 1], alone[:, 0])
    assert not torch.equal(stack[:, 0], stack[:, 1])


def test_a_seed_learns_in_a_stack_what_it_learns_alone():
    stack, alone = make_agent(num_seeds=3, seed=5, **ENSEMBLE), make_agent(num_seeds=1, seed=6, **ENSEMBLE)
    data = batches(6, 3)
    stack.update(data.clone())
    alone.update(data[:, 1:2].clone())
    for mine, other in zip(stack.policy_of(1).parameters(), alone.policy_of(0).parameters(), strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-4, atol=1e-5)


def test_state_dict_restores_the_next_subsets():
    agent, other = make_agent(num_seeds=2, **ENSEMBLE), make_agent(num_seeds=2, seed=7, **ENSEMBLE)
    agent.update(batches(3, 2))
    other.load_state_dict(copy.deepcopy(agent.state_dict()))
    for learner in (agent, other):
        learner.update(batches(3, 2, seed=1))
    for name, value in parameters(agent).items():
        assert torch.equal(value, parameters(other)[name]), name


def test_the_global_generator_is_left_alone():
    agent, before = make_agent(num_seeds=2, **ENSEMBLE), torch.get_rng_state()
    agent.update(batches(3, 2))
    assert torch.equal(before, torch.get_rng_state())


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the compiler warns of its own doings
def test_the_compiled_update_equals_the_eager_one():
    arguments = {**ENSEMBLE, "residual_penalty": 0.1}
    eager, compiled = make_agent(num_seeds=2, **arguments), make_agent(num_seeds=2, **arguments, compiled=True)
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
