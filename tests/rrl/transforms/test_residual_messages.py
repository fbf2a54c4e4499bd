"""What cannot be a residual's environment, scale or controller is named."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.envs import GymEnv, TransformedEnv
from torchrl.envs.transforms import Compose

from rrl.controllers import PIDController, ZeroController
from rrl.transforms import ResidualAction
from toy_envs import PointMass
from transform_cases import make_env, proportional, residual_with_memory


def test_an_action_alone_is_refused() -> None:
    env = make_env(residual_with_memory)
    env.reset()
    with pytest.raises(KeyError, match=r"base_action.*not an action alone"):
        env.step(TensorDict({"action": torch.zeros(2)}))


def test_a_missing_observation_is_named() -> None:
    env = TransformedEnv(PointMass(), ResidualAction(PIDController(position_key="tool")))
    with pytest.raises(KeyError, match=r"'tool'.*end_effector_position"):
        env.reset()


@pytest.mark.parametrize("scale", [-0.1, float("nan"), float("inf"), [[1.0]], [0.5, -1.0]])
def test_bad_scale(scale) -> None:
    with pytest.raises(ValueError, match="scale: expected"):
        ResidualAction(proportional(), scale=scale)


def test_scale_of_the_wrong_length() -> None:
    env = TransformedEnv(PointMass(), ResidualAction(proportional(), scale=[1.0, 1.0, 1.0]))
    tensordict = env.reset().set("action", torch.zeros(2))
    with pytest.raises(ValueError, match=r"scale: expected one number or 2, .* got 3"):
        env.step(tensordict)


def test_controller_of_the_wrong_size() -> None:
    env = TransformedEnv(PointMass([2]), ResidualAction(ZeroController(3)))
    with pytest.raises(ValueError, match=r"ZeroController: .* shape \(2, 2\), got \(2, 3\)"):
        env.reset()


def towards(position):
    return -position


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (nn.Linear(2, 2), "got a Linear; wrap it in a FunctionController"),  # knows no keys
        (towards, "got a function; wrap it in a FunctionController"),
        (partial(towards), "got a partial; call it if it makes one, else wrap it in a Function"),
        (ZeroController, "got the class ZeroController; call it"),
        (partial(ZeroController, 2), "got a partial; call it$"),
    ],
)
def test_not_a_controller(given, message) -> None:
    with pytest.raises(TypeError, match=f"^controller: expected .* TensorDict module .*{message}"):
        ResidualAction(given)


def test_a_module_that_writes_no_action() -> None:
    module = TensorDictModule(nn.Linear(2, 2), in_keys=["goal"], out_keys=["u"])
    with pytest.raises(
        KeyError, match=r"controller: .* 'base_action' or 'action', .* \['u'\]; name"
    ):
        ResidualAction(module)


class Says(ZeroController):
    """Returns something else than a tensor."""

    def __init__(self, said) -> None:
        super().__init__(2)
        self._said = said

    def act(self, tensordict):
        return self._said


@pytest.mark.parametrize(
    ("said", "got"), [(None, "None"), ([0.0, 0.0], "a list"), (np.zeros(2), "a ndarray")]
)
def test_a_controller_that_returns_no_tensor(said, got) -> None:
    env = TransformedEnv(PointMass([]), ResidualAction(Says(said)))
    with pytest.raises(TypeError, match=rf"Says: expected act\(\) to return a tensor .* got {got}"):
        env.reset()


def test_discrete_action() -> None:
    env = TransformedEnv(GymEnv("CartPole-v1"), ResidualAction(ZeroController(2)))
    with pytest.raises(TypeError, match="continuous action"):
        env.reset()


def test_base_action_key_that_is_taken() -> None:
    two = Compose(ResidualAction(proportional()), ResidualAction(proportional()))
    with pytest.raises(ValueError, match="base_action_key: expected a name"):
        TransformedEnv(PointMass(), two).reset()
