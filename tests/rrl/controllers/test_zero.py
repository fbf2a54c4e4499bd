"""The controller that does nothing."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from rrl.controllers import SumController, ZeroController
from rrl.transforms import ResidualAction
from toy_envs import PointMass


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
