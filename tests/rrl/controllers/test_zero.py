"""The controller that leaves all to the policy."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from rrl.controllers import Controller, ReplayController, SumController, ZeroController
from rrl.transforms import ResidualAction
from toy_envs import OneSided, PointMass


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_zeros_of_the_batch(batch: tuple[int, ...]) -> None:
    action = ZeroController(3)(TensorDict({}, batch_size=batch))["base_action"]
    assert torch.equal(action, torch.zeros(*batch, 3))


def test_bad_size() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        ZeroController(0)


def test_without_a_size_the_environment_says_it() -> None:
    env = TransformedEnv(PointMass((2,), dim=3), ResidualAction(SumController([ZeroController()])))
    assert torch.equal(env.reset()["base_action"], torch.zeros(2, 3))
    with pytest.raises(RuntimeError, match="action_size: expected a number or an environment"):
        ZeroController()(TensorDict({}))


class Inside(Controller):
    """Says what the controller inside it says."""

    def __init__(self) -> None:
        super().__init__([])
        self.parts = torch.nn.ModuleDict({"zero": ZeroController()})

    def act(self, tensordict: TensorDict) -> torch.Tensor:
        return self.parts["zero"].act(tensordict)


@pytest.mark.parametrize("make", [ZeroController, lambda: ZeroController(4), Inside])
@pytest.mark.parametrize("batch", [(), (3,)])
def test_the_policy_reaches_the_whole_range_and_nothing_else(make, batch) -> None:
    env = TransformedEnv(OneSided(batch), ResidualAction(make(), scale=1.0))
    for action, executed in ((-1.0, [0.0, 2.0, -1.0, 5.0]), (1.0, [1.0, 4.0, 1.0, 6.0])):
        env.step(env.reset().set("action", torch.full((*batch, 4), action)))
        assert torch.equal(env.base_env.executed, torch.tensor(executed).expand(*batch, 4))


def test_in_a_sum_it_adds_nothing() -> None:
    plan = ReplayController([[0.25, 2.5, 0.5, 5.5]])
    chain = ResidualAction(SumController([ZeroController(), plan]))
    base_action = TransformedEnv(OneSided(), chain).reset()["base_action"]
    assert torch.equal(base_action, plan.actions[0])
