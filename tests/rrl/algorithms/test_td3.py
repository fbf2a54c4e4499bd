"""TD3 equals the plain composition of TorchRL's parts."""

import copy

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SoftUpdate, TD3Loss

from agents import OBSERVATION, batches, learn, make_agent, parameters


def test_equals_torchrl_loss_adam_and_soft_update():
    agent, k = make_agent(last_layer_bound=0.1, reward_scale=2.0), 10
    loss = copy.deepcopy(agent.loss)
    assert type(loss) is TD3Loss
    data = batches(k)
    torch.manual_seed(1)
    agent.update(data.clone())

    critic, actor = (
        torch.optim.Adam(list(params.values(True, True)), lr=1e-3)
        for params in (loss.qvalue_network_params, loss.actor_network_params)
    )
    targets = SoftUpdate(loss, tau=0.005)
    torch.manual_seed(1)
    for i in range(k):
        batch = agent.readings.prepare(data)[i]
        batch["next", "reward"] *= 2.0
        critic.zero_grad()
        loss.value_loss(batch)[0].backward()
        critic.step()
        if i % 2 == 1:
            actor.zero_grad()
            loss.actor_loss(batch)[0].backward()
            actor.step()
            targets.step()
    for name, expected in loss.state_dict().items():
        torch.testing.assert_close(agent.loss.state_dict()[name], expected, rtol=1e-5, atol=1e-6)


def test_policy_and_targets_wait_for_their_turn():
    agent = make_agent(policy_delay=3, last_layer_bound=0.1)
    before = copy.deepcopy(parameters(agent))
    learn(agent, 2)
    after = parameters(agent)
    moved = {name for name in before if not torch.equal(before[name], after[name])}
    assert any("loss.qvalue_network_params" in name for name in moved)
    assert not any("target" in name or "loss.actor_network_params" in name for name in moved)
    learn(agent, 1)
    after = parameters(agent)
    moved = {name for name in before if not torch.equal(before[name], after[name])}
    for part in ("target_actor", "target_qvalue", "loss.actor_network_params", "policy"):
        assert any(part in name for name in moved), part


def test_metrics_are_scalars_without_gradient():
    metrics = learn(make_agent(), 3)
    assert set(metrics) == {"loss_critic", "loss_actor", "q_value", "target_value"}
    assert all(value.shape == () and not value.requires_grad for value in metrics.values())


def test_the_policy_takes_any_leading_shape():
    agent = make_agent(last_layer_bound=0.5)
    observation = torch.randn(2, 3, OBSERVATION)
    every = agent.policy(TensorDict({"observation": observation}, [2, 3]))["action"]
    flat = agent.policy(TensorDict({"observation": observation.reshape(6, -1)}, [6]))["action"]
    assert torch.equal(every.reshape(6, -1), flat)
    alone = agent.policy(TensorDict({"observation": observation[1, 2]}, []))["action"]
    torch.testing.assert_close(alone, every[1, 2])


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("target_noise", -0.1, "target_noise"),
        ("actor_lr", 0.0, "actor_lr"),
        ("num_critics", 1, "target_subset"),
        ("target_subset", 0, "target_subset"),
        ("nonsense", 1, "nonsense"),
    ],
)
def test_bad_hyperparameters_are_named(name, value, message):
    with pytest.raises(ValueError, match=message):
        make_agent(**{name: value})
