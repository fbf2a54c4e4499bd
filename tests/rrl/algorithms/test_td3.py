"""Stacked TD3 is TD3: it equals the plain composition of TorchRL's parts, seed by seed."""

import copy

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SoftUpdate

from agents import OBSERVATION, batches, make_agent, parameters


def test_equals_torchrl_loss_adam_and_soft_update():
    agent, k = make_agent(last_layer_bound=0.1, reward_scale=2.0), 10
    loss = copy.deepcopy(agent.loss)
    data = batches(k, 1)
    noise = copy.deepcopy(agent)._draw_smoothing(data["action"].shape)
    agent.update(data.clone())

    critic, actor = (
        torch.optim.Adam(list(params.values(True, True)), lr=1e-3)
        for params in (loss.qvalue_network_params, loss.actor_network_params)
    )
    targets = SoftUpdate(loss, tau=0.005)
    for i in range(k):
        batch = data[i].clone()
        batch["next", "reward"] *= 2.0
        batch["next", "target_smoothing"] = noise[i]
        critic.zero_grad()
        loss.value_loss(batch)[0].mean().backward()
        critic.step()
        if i % 2 == 1:
            actor.zero_grad()
            loss.actor_loss(batch)[0].mean().backward()
            actor.step()
            targets.step()
    for name, expected in loss.state_dict().items():
        torch.testing.assert_close(agent.loss.state_dict()[name], expected, rtol=1e-5, atol=1e-6)


def test_policy_and_targets_wait_for_their_turn():
    agent = make_agent(policy_delay=3, last_layer_bound=0.1)
    before = copy.deepcopy(parameters(agent))
    agent.update(batches(2, 1))
    after = parameters(agent)
    moved = {name for name in before if not torch.equal(before[name], after[name])}
    assert any("loss.qvalue_network_params" in name for name in moved)
    assert not any("target" in name or "loss.actor_network_params" in name for name in moved)
    agent.update(batches(1, 1))
    assert any(
        "target_actor" in n
        for n in parameters(agent)
        if not torch.equal(before[n], parameters(agent)[n])
    )


def test_the_policy_takes_any_leading_shape():
    agent = make_agent(num_seeds=2, last_layer_bound=0.5)
    observation = torch.randn(2, 3, OBSERVATION)
    stacked = agent.policy(TensorDict({"observation": observation}, [2, 3]))["action"]
    flat = agent.policy(TensorDict({"observation": observation.reshape(6, -1)}, [6]))["action"]
    assert torch.equal(stacked.reshape(6, -1), flat)
    alone = agent.policy_of(1)(TensorDict({"observation": observation[1, 2]}, []))["action"]
    torch.testing.assert_close(alone, stacked[1, 2])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("target_noise", -0.1),
        ("actor_lr", 0.0),
        ("num_critics", 1),
        ("target_subset", 0),
        ("residual_penalty", -1.0),
    ],
)
def test_bad_hyperparameters_are_named(name, value):
    with pytest.raises(
        ValueError,
        match={"actor_lr": "learning rate", "num_critics": "target_subset"}.get(name, name),
    ):
        make_agent(**{name: value})
