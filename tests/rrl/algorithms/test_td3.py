"""Stacked TD3 is TD3: it equals the plain composition of TorchRL's parts, seed by seed."""

import copy

import pytest
import torch
from tensordict import TensorDict
from torchrl.objectives import SoftUpdate

from rrl.algorithms import TD3

BATCH, OBSERVATION, ACTION = 16, 5, 2


def make(num_seeds=1, **arguments):
    return TD3({"observation": OBSERVATION}, ACTION, num_seeds=num_seeds, hidden=[32, 32], **arguments)


def batches(k, num_seeds, seed=0):
    g = torch.Generator().manual_seed(seed)
    shape = k, num_seeds, BATCH

    def normal(size):
        return torch.randn(*shape, size, generator=g)

    terminated = torch.rand(*shape, 1, generator=g) < 0.1
    following = {"observation": normal(OBSERVATION), "reward": normal(1), "done": terminated.clone()}
    return TensorDict(
        {
            "observation": normal(OBSERVATION),
            "action": normal(ACTION).tanh(),
            "next": {**following, "terminated": terminated},
        },
        shape,
    )


def parameters(agent):
    return {k: v for k, v in agent.state_dict().items() if isinstance(v, torch.Tensor)}


def test_equals_torchrl_loss_adam_and_soft_update():
    agent, k = make(last_layer_bound=0.1, reward_scale=2.0), 10
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
    agent = make(policy_delay=3, last_layer_bound=0.1)
    before = copy.deepcopy(parameters(agent))
    agent.update(batches(2, 1))
    after = parameters(agent)
    moved = {name for name in before if not torch.equal(before[name], after[name])}
    assert any("loss.qvalue_network_params" in name for name in moved)
    assert not any("target" in name or "loss.actor_network_params" in name for name in moved)
    agent.update(batches(1, 1))
    assert any("target_actor" in n for n in parameters(agent) if not torch.equal(before[n], parameters(agent)[n]))


@pytest.mark.parametrize("layer_norm", [False, True])
def test_seeds_do_not_touch_each_other(layer_norm):
    one, other = make(3, layer_norm=layer_norm), make(3, layer_norm=layer_norm)
    data = batches(4, 3)
    changed = data.clone()
    changed["next", "reward"][:, 1] += 10.0
    one.update(data)
    other.update(changed)
    for k, same in ((0, True), (1, False), (2, True)):
        pairs = zip(one.policy_of(k).parameters(), other.policy_of(k).parameters(), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs) is same


def test_an_untrained_residual_is_exactly_zero():
    agent = make(2)
    td = TensorDict({"observation": torch.randn(2, OBSERVATION)}, [2])
    assert torch.equal(agent.policy(td)["action"], torch.zeros(2, ACTION))


def test_the_policy_takes_any_leading_shape():
    agent = make(2, last_layer_bound=0.5)
    observation = torch.randn(2, 3, OBSERVATION)
    stacked = agent.policy(TensorDict({"observation": observation}, [2, 3]))["action"]
    flat = agent.policy(TensorDict({"observation": observation.reshape(6, -1)}, [6]))["action"]
    assert torch.equal(stacked.reshape(6, -1), flat)
    alone = agent.policy_of(1)(TensorDict({"observation": observation[1, 2]}, []))["action"]
    torch.testing.assert_close(alone, stacked[1, 2])


def test_state_dict_restores_the_next_update_to_the_last_bit():
    agent, other = make(2), make(2, seed=7)
    agent.update(batches(3, 2))
    other.load_state_dict(agent.state_dict())
    for learner in (agent, other):
        learner.update(batches(3, 2, seed=1))
    for name, value in parameters(agent).items():
        assert torch.equal(value, parameters(other)[name]), name


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the compiler warns of its own doings
def test_the_compiled_update_equals_the_eager_one():
    eager, compiled = make(2, last_layer_bound=0.1), make(2, last_layer_bound=0.1, compiled=True)
    for learner in (eager, compiled):
        learner.update(batches(10, 2))
    for name, value in parameters(eager).items():
        torch.testing.assert_close(parameters(compiled)[name], value, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "value"),
    [("gamma", 1.0), ("tau", 0.0), ("policy_delay", 0), ("target_noise", -0.1), ("actor_lr", 0.0)],
)
def test_bad_hyperparameters_are_named(name, value):
    with pytest.raises(ValueError, match="learning rate" if name == "actor_lr" else name):
        make(**{name: value})
