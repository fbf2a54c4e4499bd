"""A trained policy as the controller: frozen, deterministic, closed loop."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import (
    InteractionType,
    ProbabilisticTensorDictModule,
    TensorDictModule,
    TensorDictSequential,
)
from torch import nn
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import AdditiveGaussianModule, LSTMModule, NormalParamExtractor, TanhNormal

from rrl.controllers import PolicyController, ProportionalController
from rrl.transforms import ResidualAction
from toy_envs import PointMass


class Steer(nn.Module):
    """Learned gain towards the goal, with dropout to tell training from evaluation."""

    def __init__(self) -> None:
        super().__init__()
        self.gain = nn.Parameter(torch.tensor(5.0))
        self.dropout = nn.Dropout(0.9)

    def forward(self, position: torch.Tensor, goal: torch.Tensor) -> torch.Tensor:
        return self.dropout(torch.clamp(self.gain * (goal - position), -1.0, 1.0))


def make_policy(*names: str) -> TensorDictModule:
    return TensorDictModule(
        Steer(), in_keys=list(names or ("end_effector_position", "goal")), out_keys=["action"]
    )


def data() -> TensorDict:
    torch.manual_seed(0)
    values = {"end_effector_position": torch.rand(4, 2), "goal": torch.rand(4, 2)}
    return TensorDict(values, batch_size=[4])


def test_closed_loop_equals_the_law_it_learned() -> None:
    learned = TransformedEnv(PointMass([3]), ResidualAction(PolicyController(make_policy())))
    law = TransformedEnv(PointMass([3]), ResidualAction(ProportionalController(gain=5.0)))
    zero = torch.zeros(3, 2)
    rollouts = [env.rollout(20, lambda td: td.set("action", zero)) for env in (learned, law)]
    assert torch.equal(*(rollout["next", "end_effector_position"] for rollout in rollouts))


def test_frozen_and_in_evaluation_mode_whatever_happens_around() -> None:
    controller = PolicyController(make_policy())
    controller.train()
    nn.Sequential(controller).train()
    assert not any(module.training for module in controller.policy.modules())
    assert not any(parameter.requires_grad for parameter in controller.parameters())
    out = controller(data())
    assert not out["base_action"].requires_grad
    assert torch.equal(out["base_action"], controller(data())["base_action"])


def test_training_the_original_does_not_change_the_controller() -> None:
    policy = make_policy()
    controller = PolicyController(policy)
    before = controller.act(data())
    with torch.no_grad():
        policy.module.gain.mul_(2.0)
    assert torch.equal(controller.act(data()), before)
    assert policy.module.gain.requires_grad


def test_no_exploration_even_where_the_collector_explores() -> None:
    spec = PointMass([4]).action_spec
    noisy = TensorDictSequential(make_policy(), AdditiveGaussianModule(spec, sigma_init=1.0))
    controller = PolicyController(noisy)
    with set_exploration_type(ExplorationType.RANDOM):
        out = controller.act(data())
    assert torch.equal(out, PolicyController(make_policy()).act(data()))


def test_stochastic_policy_gives_its_mode_and_only_its_action() -> None:
    network = nn.Sequential(nn.Linear(2, 4), NormalParamExtractor())
    actor = TensorDictSequential(
        TensorDictModule(network, in_keys=["goal"], out_keys=["loc", "scale"]),
        ProbabilisticTensorDictModule(
            in_keys=["loc", "scale"],
            out_keys=["action"],
            distribution_class=TanhNormal,
            default_interaction_type=InteractionType.RANDOM,
        ),
    )
    controller = PolicyController(actor)
    with set_exploration_type(ExplorationType.RANDOM):
        out = controller(data())
        assert torch.equal(out["base_action"], controller(data())["base_action"])
    assert set(out.keys()) == {"end_effector_position", "goal", "base_action"}


def test_key_map_renames_what_the_policy_reads() -> None:
    controller = PolicyController(
        make_policy("tool", "target"),
        key_map={"tool": "end_effector_position", "target": "goal"},
    )
    assert controller.in_keys == ["end_effector_position", "goal"]
    assert torch.equal(controller.act(data()), PolicyController(make_policy()).act(data()))


def test_checkpoint(tmp_path) -> None:
    trained = make_policy()
    with torch.no_grad():
        trained.module.gain.fill_(0.3)
    torch.save(trained.state_dict(), tmp_path / "policy.pt")
    controller = PolicyController(make_policy(), checkpoint=tmp_path / "policy.pt")
    assert torch.equal(controller.act(data()), PolicyController(trained).act(data()))


def test_checkpoint_that_is_missing_or_does_not_fit(tmp_path) -> None:
    with pytest.raises(FileNotFoundError, match=r"checkpoint: expected a file .*nowhere.pt"):
        PolicyController(make_policy(), checkpoint=tmp_path / "nowhere.pt")
    torch.save(nn.Linear(2, 2).state_dict(), tmp_path / "other.pt")
    with pytest.raises(RuntimeError, match="Missing key"):
        PolicyController(make_policy(), checkpoint=tmp_path / "other.pt")


def test_what_is_not_a_policy() -> None:
    with pytest.raises(TypeError, match="TensorDict module with in_keys and out_keys"):
        PolicyController(nn.Linear(2, 2))
    with pytest.raises(KeyError, match=r"action_key: expected one of .*'torque'"):
        PolicyController(make_policy(), action_key="torque")
    with pytest.raises(ValueError, match=r"key_map: expected .* got \['blocks'\]"):
        PolicyController(make_policy(), key_map={"blocks": "goal"})


def test_a_recurrent_policy_is_refused_because_nothing_would_keep_its_memory() -> None:
    recurrent = TensorDictSequential(
        LSTMModule(input_size=2, hidden_size=2, in_key="goal", out_key="seen"),
        TensorDictModule(nn.Linear(2, 2), in_keys=["seen"], out_keys=["action"]),
    )
    with pytest.raises(ValueError, match=r"policy: expected .* observations alone, .*recurrent_s"):
        PolicyController(recurrent)


def test_missing_key_is_named_beside_what_can_be_copied() -> None:
    entries = TensorDict({"arm": {"goal": torch.zeros(4, 2), "flat": torch.zeros(4)}}, [4])
    entries["x"], entries["safety", "step"] = torch.zeros(4, 2), torch.zeros(4, 1)
    there = r"\[\('arm', 'flat'\), \('arm', 'goal'\), 'x'\]"
    with pytest.raises(KeyError, match=f"PolicyController: expected the entry 'goal', got {there}"):
        PolicyController(make_policy("x", "goal")).act(entries)


def test_a_policy_may_read_a_group() -> None:
    module = TensorDictModule(lambda arm: 0.5 * arm["x"], in_keys=["arm"], out_keys=["action"])
    entries = TensorDict({"arm": {"x": torch.ones(4, 2)}}, [4])
    assert (PolicyController(module).act(entries) == 0.5).all()
