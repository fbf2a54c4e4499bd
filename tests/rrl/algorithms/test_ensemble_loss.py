"""Losses of ensembles are TorchRL losses: for two critics they are its own, and they keep its contract."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.objectives import LossModule, SoftUpdate
from torchrl.objectives.utils import ValueEstimators

from agents import ACTION, BATCH, OBSERVATION, batches
from ensembles import TORCHRL, actor, assert_same, each_loss, losses_and_gradients, make_loss
from rrl.algorithms import EnsembleSACLoss, EnsembleTD3Loss, mlp

OTHER_KEYS = {
    "action": ("arm", "act"),
    "reward": "gain",
    "done": "over",
    "terminated": "failed",
    "state_action_value": "q",
    "priority": "surprise",
    "priority_weight": "weight",
}


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
@pytest.mark.parametrize("reduction", ["none", "mean", "sum"])
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("mask", [("collector", "mask"), "shifted_valid", "own", None])
def test_masked_steps_do_not_count(kind, reduction, weighted, mask):
    """As in TorchRL, which finds its own masks by itself, and others by name."""
    data = batches(1)[0]
    for name in (("collector", "mask"), "own"):
        data[name] = torch.arange(BATCH) % 3 > 0
    data["shifted_valid"] = (torch.arange(BATCH) % 4 > 0).unsqueeze(-1)
    if weighted:
        data["priority_weight"] = torch.rand(BATCH, generator=torch.Generator().manual_seed(1))
    mine, torchrls = (make_loss(k, reduction=reduction) for k in (kind, TORCHRL[kind]))
    for loss in (mine, torchrls):
        loss.loss_mask_key = "auto" if mask == "shifted_valid" else mask
    found, expected = (losses_and_gradients(loss, data.clone())[0] for loss in (mine, torchrls))
    assert_same(found, expected)


@each_loss
@pytest.mark.parametrize("weighted", [False, True])
def test_a_mask_of_steps_holds_for_several_agents(kind, weighted):
    """Two agents' losses [B, 2] under one mask [B, 1]."""
    keys = {name: ("agents", name) for name in ("action", "reward", "done", "terminated")}
    keys["state_action_value"] = ("agents", "value")
    loss = make_loss(kind, num_critics=4, keys=keys, observation=("agents", "observation"))
    one, other = batches(2).unbind(0)
    entries = torch.stack([one, other], 1)  # (B, 2)
    root = {"agents": entries.exclude("next"), "next": {"agents": entries["next"]}}
    data = TensorDict(root, [BATCH])
    kept = torch.arange(BATCH) % 3 > 0
    data["collector", "mask"] = kept.unsqueeze(-1)
    if weighted:
        data["priority_weight"] = torch.ones(BATCH)
    spoilt = data.clone()
    spoilt["next", "agents", "reward"][~kept] = 100.0
    found, expected = (losses_and_gradients(loss, d)[0] for d in (spoilt, data))
    assert_same(found, expected)
    assert found["loss_qvalue"].isfinite()


@each_loss
@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_without_vmap_torch_can_compile_it(kind):
    data = batches(1)[0]
    eager, compiled = (make_loss(kind, num_critics=4, deactivate_vmap=True) for _ in range(2))
    torch.manual_seed(5)
    expected = eager(data.clone())["loss_qvalue"]
    torch.manual_seed(5)
    found = torch.compile(compiled, backend="eager")(data.clone())["loss_qvalue"]
    torch.testing.assert_close(found, expected)


def test_the_temperature_stays_within_its_bounds():
    """It is 0.5 when the loss is made."""
    data = batches(1)[0]
    for bounds in ({"min_alpha": 0.8}, {"max_alpha": 0.1}, {"min_alpha": 0.6, "max_alpha": 0.9}):
        mine, torchrls = (
            losses_and_gradients(make_loss(k, **bounds), data.clone())
            for k in (EnsembleSACLoss, TORCHRL[EnsembleSACLoss])
        )
        assert_same(mine[0], torchrls[0])
        torch.testing.assert_close(mine[1]["alpha"], torchrls[1]["alpha"])
        assert mine[1]["alpha"] != 0.5


@each_loss
def test_critics_without_vmap_come_to_the_same(kind):
    data = batches(1)[0]
    plain, looped = (
        losses_and_gradients(make_loss(kind, num_critics=4, deactivate_vmap=d), data.clone())[0]
        for d in (False, True)
    )
    assert_same(looped, plain)


def test_what_an_ensemble_does_not_have_is_refused():
    value = TensorDictModule(mlp(OBSERVATION, 1), ["observation"], ["state_value"])
    for arguments in ({"skip_done_states": True}, {"value_network": value}):
        (name,) = arguments
        with pytest.raises(ValueError, match=f"{name}: expected none for an ensemble.*leave it"):
            make_loss(EnsembleSACLoss, **arguments)


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
