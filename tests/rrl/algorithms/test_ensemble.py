"""Ensembles of critics: what target and policy see of them, and that their losses are TorchRL losses."""

import copy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
    TensorDictModule,
)
from torch import nn
from torchrl.modules import NormalParamExtractor, TanhNormal
from torchrl.objectives import LossModule, SACLoss, SoftUpdate, TD3Loss
from torchrl.objectives.utils import ValueEstimators

from agents import ACTION, BATCH, OBSERVATION, batches, critics, learn, make_agent, parameters
from rrl.algorithms import SAC, TD3, EnsembleSACLoss, EnsembleTD3Loss, mlp

ENSEMBLE = {"num_critics": 5, "target_subset": 2, "layer_norm": True, "last_layer_bound": 0.1}
TORCHRL = {EnsembleTD3Loss: TD3Loss, EnsembleSACLoss: SACLoss}
AS_TORCHRL = {EnsembleTD3Loss: "first", EnsembleSACLoss: "least"}
OTHER_KEYS = {
    "action": ("arm", "act"),
    "reward": "gain",
    "done": "over",
    "terminated": "failed",
    "state_action_value": "q",
    "priority": "surprise",
    "priority_weight": "weight",
}

each_algorithm = pytest.mark.parametrize("algorithm", [TD3, SAC])
each_loss = pytest.mark.parametrize("kind", [EnsembleTD3Loss, EnsembleSACLoss])


def actor(kind, action):
    if issubclass(kind, TD3Loss):
        network = nn.Sequential(mlp(OBSERVATION, ACTION, hidden=[16]), nn.Tanh())
        return TensorDictModule(network, ["observation"], [action])
    network = nn.Sequential(mlp(OBSERVATION, 2 * ACTION, hidden=[16]), NormalParamExtractor())
    return ProbabilisticTensorDictSequential(
        TensorDictModule(network, ["observation"], ["loc", "scale"]),
        ProbabilisticTensorDictModule(
            in_keys=["loc", "scale"],
            out_keys=[action],
            distribution_class=TanhNormal,
            return_log_prob=True,
        ),
    )


def make_loss(kind, num_critics=2, keys=None, dropout=0.0, estimator=None, **arguments):
    """A loss on small networks, the same ones for every kind with the same actor, with targets of their own."""
    torch.manual_seed(0)
    names = {"action": "action", "state_action_value": "state_action_value"} | (keys or {})
    networks = [
        nn.Sequential(mlp(OBSERVATION + ACTION, 16, hidden=[16]), nn.Dropout(dropout), mlp(16, 1))
        if dropout
        else mlp(OBSERVATION + ACTION, 1, hidden=[16])
        for _ in range(num_critics)
    ]
    inputs = ["observation", names["action"]]
    if dropout:
        networks = [Joined(network) for network in networks]
    qs = [TensorDictModule(n, inputs, [names["state_action_value"]]) for n in networks]
    if issubclass(kind, TD3Loss):
        arguments["bounds"] = (-1.0, 1.0)
    else:
        arguments |= {"target_entropy": -float(ACTION), "alpha_init": 0.5}
        if arguments.get("reduction") == "none":
            arguments["scalar_output_mode"] = "exclude"
    if kind in TORCHRL:
        arguments = {"policy_value": AS_TORCHRL[kind]} | arguments
    loss = kind(actor(kind, names["action"]), qs, num_qvalue_nets=num_critics, **arguments)
    if keys:
        loss.set_keys(**keys)
    loss.make_value_estimator(estimator or ValueEstimators.TD0, gamma=0.9)
    SoftUpdate(loss, tau=0.5)  # without one, a loss with targets warns
    targets = [loss.target_qvalue_network_params]
    if issubclass(kind, TD3Loss):
        targets.append(loss.target_actor_network_params)
    for params in targets:
        for value in params.values(True, True):
            value.data.add_(0.1 * torch.randn_like(value))
    return loss


class Joined(nn.Module):
    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, *inputs):
        return self.network(torch.cat(inputs, -1))


def losses_and_gradients(loss, data):
    """What a call gives, and the gradients of each loss for all parameters."""
    torch.manual_seed(5)
    out = loss(data)
    found = {}
    params = dict(loss.named_parameters())
    for name in sorted(key for key in set(out.keys()) if key.startswith("loss_")):
        found[name] = out[name].detach()
        gradients = torch.autograd.grad(
            out[name].sum(), list(params.values()), retain_graph=True, allow_unused=True
        )
        for parameter, gradient in zip(params, gradients, strict=True):
            if gradient is not None:
                found[f"{name} of {parameter}"] = gradient
    return found, out


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    assert len(found) >= 10  # both losses, and gradients of critics and actor
    for name, value in expected.items():
        torch.testing.assert_close(
            found[name], value, rtol=1e-4, atol=1e-5, msg=lambda m, n=name: f"{n}: {m}"
        )


# -------------------------------------------------------------------- TorchRL's losses are a case


@each_loss
@pytest.mark.parametrize("loss_function", ["l2", "l1", "smooth_l1"])
def test_two_critics_with_both_in_the_target_have_torchrls_losses_and_gradients(
    kind, loss_function
):
    data = batches(1)[0]
    mine, torchrls = (
        losses_and_gradients(make_loss(k, loss_function=loss_function), data.clone())
        for k in (kind, TORCHRL[kind])
    )
    assert_same(mine[0], torchrls[0])
    assert set(mine[1].keys()) == set(torchrls[1].keys())
    for name, value in torchrls[1].items():
        if name != "state_action_value_actor":  # ours are only those that the policy climbs
            torch.testing.assert_close(mine[1][name], value, rtol=1e-4, atol=1e-5)


@each_loss
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize(("reduction", "shape"), [("none", (BATCH,)), ("mean", ()), ("sum", ())])
def test_losses_are_reduced_as_torchrl_reduces_them(kind, reduction, shape, weighted):
    data = batches(1)[0]
    if weighted:
        data["priority_weight"] = torch.rand(BATCH, generator=torch.Generator().manual_seed(1))
    given = [data.clone(), data.clone()]
    mine, torchrls = (
        losses_and_gradients(make_loss(k, reduction=reduction), d)
        for k, d in zip((kind, TORCHRL[kind]), given, strict=True)
    )
    assert mine[1]["loss_qvalue"].shape == mine[1]["loss_actor"].shape == shape
    assert_same(mine[0], torchrls[0])
    torch.testing.assert_close(given[0]["td_error"], given[1]["td_error"], rtol=1e-4, atol=1e-5)
    assert given[0]["td_error"].shape == (BATCH,)


@each_loss
@pytest.mark.parametrize("estimator", [ValueEstimators.TD0, ValueEstimators.TDLambda])
def test_targets_come_from_the_value_estimator(kind, estimator):
    data = batches(4).transpose(0, 1).contiguous()  # [B, T]
    mine, torchrls = (
        losses_and_gradients(make_loss(k, estimator=estimator), data.clone())[0]
        for k in (kind, TORCHRL[kind])
    )
    assert_same(mine, torchrls)
    other = losses_and_gradients(make_loss(kind, estimator=ValueEstimators.TD1), data.clone())[0]
    assert not torch.allclose(other["loss_qvalue"], mine["loss_qvalue"])


# -------------------------------------------------------------------- TorchRL's contract of a loss


@each_loss
def test_a_call_gives_the_out_keys_and_writes_the_priority(kind):
    loss, data = make_loss(kind, num_critics=4, policy_value="mean"), batches(1)[0]
    assert isinstance(loss, LossModule)
    assert list(loss.out_keys) == list(make_loss(TORCHRL[kind]).out_keys)
    out = loss(data)
    assert set(out.keys()) == set(loss.out_keys)
    assert out["loss_qvalue"].requires_grad
    assert out["loss_actor"].requires_grad
    assert data["td_error"].shape == (BATCH,)
    assert (data["td_error"] >= 0).all()


@each_loss
def test_a_call_takes_the_in_keys_alone(kind):
    loss, data = make_loss(kind, num_critics=4), batches(1)[0]
    needed = {"observation", "action", *(("next", k) for k in ("observation", "reward"))}
    assert set(loss.in_keys) == needed | {("next", "done"), ("next", "terminated")}
    torch.manual_seed(5)
    whole = loss(data.clone())
    torch.manual_seed(5)
    alone = loss(data.select(*loss.in_keys))
    torch.manual_seed(5)
    named = {k if isinstance(k, str) else "_".join(k): data[k] for k in loss.in_keys}
    dispatched = dict(zip(loss.out_keys, loss(**named), strict=True))
    for name in ("loss_qvalue", "loss_actor"):
        assert torch.equal(whole[name], alone[name])
        assert torch.equal(whole[name], dispatched[name])


@each_loss
def test_keys_can_have_other_names(kind):
    data = batches(1)[0]
    data["priority_weight"] = torch.rand(BATCH, generator=torch.Generator().manual_seed(1))
    renamed = TensorDict(
        {
            "observation": data["observation"],
            OTHER_KEYS["action"]: data["action"],
            "weight": data["priority_weight"],
            "next": {
                "observation": data["next", "observation"],
                **{OTHER_KEYS[k]: data["next", k] for k in ("reward", "done", "terminated")},
            },
        },
        [BATCH],
    )
    loss = make_loss(kind, num_critics=4, keys=OTHER_KEYS)
    assert {("arm", "act"), ("next", "gain"), ("next", "failed")} <= set(loss.in_keys)
    found = losses_and_gradients(loss, renamed)[0]
    expected = losses_and_gradients(make_loss(kind, num_critics=4), data)[0]
    assert_same(found, expected)
    assert torch.equal(renamed["surprise"], data["td_error"])
    with pytest.raises(ValueError, match="not an accepted tensordict key"):
        loss.set_keys(nonsense="x")


@each_loss
def test_soft_updates_move_all_target_critics(kind):
    loss = make_loss(kind, num_critics=4)
    online, target = loss.qvalue_network_params, loss.target_qvalue_network_params
    update = SoftUpdate(loss, tau=0.25)
    for value in target.values(True, True):
        value.data.add_(0.1 * torch.randn_like(value))
    before = target.data.clone()
    update.step()
    for key, value in target.items(True, True):
        assert value.shape[0] == 4
        torch.testing.assert_close(value, before[key].lerp(online[key].data, 0.25))


@each_loss
def test_random_layers_of_critics_draw_as_vmap_randomness_says(kind):
    loss, data = make_loss(kind, num_critics=4, dropout=0.5), batches(1)[0]
    assert make_loss(kind).vmap_randomness == "error"
    assert loss.vmap_randomness == "different"

    def dropped():  # identical critics: only the dropout tells them apart
        params = loss.qvalue_network_params.data
        same = params[:1].expand(4, *params.shape[1:]).clone()
        values = loss._values(data.clone(), same)
        return not torch.allclose(values[0], values[1])

    assert dropped()
    assert loss(data.clone())["loss_qvalue"].isfinite()
    loss.set_vmap_randomness("same")
    assert not dropped()
    assert loss(data.clone())["loss_qvalue"].isfinite()
    loss.set_vmap_randomness("error")
    with pytest.raises(RuntimeError, match="randomness"):
        loss(data.clone())


@each_loss
def test_critics_given_as_a_list_keep_their_initialization_and_one_is_multiplied(kind):
    listed = make_loss(kind, num_critics=3).qvalue_network_params
    assert all(value.unique(dim=0).shape[0] == 3 for value in listed.values(True, True))
    one = TensorDictModule(
        mlp(OBSERVATION + ACTION, 1), ["observation", "action"], ["state_action_value"]
    )
    arguments = {"bounds": (-1.0, 1.0)} if kind is EnsembleTD3Loss else {"target_entropy": -2.0}
    loss = kind(actor(kind, "action"), one, num_qvalue_nets=3, **arguments)
    assert loss.target_subset == 2
    assert loss.policy_value == "mean"
    assert loss.qvalue_network_params.shape == (3,)


@each_loss
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"target_subset": 0}, r"target_subset: expected 1 to num_qvalue_nets \(2\)"),
        ({"target_subset": 3}, "got 3"),
        ({"policy_value": "most"}, "policy_value: expected one of mean, first, least, got 'most'"),
    ],
)
def test_bad_arguments_are_named(kind, arguments, message):
    with pytest.raises(ValueError, match=message):
        make_loss(kind, **arguments)


# -------------------------------------------------------------------- the ensemble


def drawn_critics(count, size):
    """The next critics in the target, from torch's generator."""
    return torch.rand(count).argsort()[:size]


def test_the_target_is_the_least_of_the_drawn_critics():
    agent = make_agent(gamma=0.9, **ENSEMBLE)
    learn(agent, 6, seed=3)
    batch = batches(1)[0]
    torch.manual_seed(2)
    loss, info = agent.value_loss(batch)
    torch.manual_seed(2)
    noise = (0.2 * torch.randn(BATCH, ACTION)).clamp(-0.5, 0.5)
    drawn = drawn_critics(5, 2)
    with torch.no_grad():
        following = batch["next"].select("observation")
        with agent.loss.target_actor_network_params.data.to_module(agent.loss.actor_network):
            action = agent.loss.actor_network(following)["action"] + noise
        inputs = batch["next", "observation"], action.clamp(-1, 1)
        values = [q(*inputs) for q in critics(agent.loss, "target_qvalue_network_params")]
        least = torch.stack(values)[drawn].amin(0)
        goes_on = ~batch["next", "terminated"].squeeze(-1)
        target = batch["next", "reward"].squeeze(-1) + 0.9 * goes_on * least
        now = [
            q(batch["observation"], batch["action"])
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
