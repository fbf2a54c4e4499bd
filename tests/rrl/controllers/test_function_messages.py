"""What a function says or raises that is no action: the message names it."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.envs import TransformedEnv

from rrl.controllers import FunctionController
from rrl.transforms import ResidualAction
from toy_envs import PointMass

KEYS = ["end_effector_position", "goal"]


def state(batch) -> TensorDict:
    values = {key: torch.rand(*batch, 2) for key in KEYS}
    return TensorDict(values, batch_size=batch)


def law(error):
    return 0.5 * error


@pytest.mark.parametrize("batched", [False, True])
@pytest.mark.parametrize(
    ("said", "got"),
    [
        (None, "None"),
        ("left", "'left'"),
        ({"action": [0.0]}, "a dict"),
        ((np.zeros(2), {}), "a tuple of ndarray, dict"),
        (np.array([None, 1.0]), "a ndarray"),
    ],
    ids=["None", "text", "dict", "action and info", "objects"],
)
def test_no_array_of_numbers(said, got, batched) -> None:
    def pd(position):
        return said

    shape = r"\[\*batch, n_act\]" if batched else r"\[n_act\]"
    with pytest.raises(TypeError, match=f"^pd: expected an action of shape {shape}, got {got}$"):
        FunctionController(pd, KEYS[:1], batched=batched).act(state([2]))


def test_not_one_action_a_slot() -> None:
    with pytest.raises(ValueError, match=r"constant: expected an action of shape \[n_act\], got"):

        def constant(position):
            return np.array(0.0)

        FunctionController(constant, KEYS[:1]).act(state([2]))


def test_a_group_in_the_place_of_a_tensor() -> None:
    entries = TensorDict({"goal": {"a": torch.zeros(4, 2)}}, [4])
    with pytest.raises(TypeError, match=r"^law: .*'goal' to be a tensor, .* \[\('goal', 'a'\)\]"):
        FunctionController(law, ["goal"]).act(entries)


def test_actions_of_several_lengths() -> None:
    lengths = iter([1, 2])
    controller = FunctionController(lambda position: np.zeros(next(lengths)), KEYS[:1])
    with pytest.raises(ValueError, match=r"expected an action of shape .*, got \(1,\) and \(2,\)"):
        controller.act(state([2]))


class Scripted:
    def get_action(self, position, goal, gain=1.0):
        return gain * np.zeros(3)

    def __call__(self, position, goal):
        return np.zeros(3)


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (Scripted, "Scripted"),
        (Scripted().get_action, r"Scripted\.get_action"),
        (partial(partial(Scripted().get_action, gain=2.0)), r"Scripted\.get_action"),
        (lambda position, goal: np.zeros(3), r"the lambda in test_function_messages\.py:\d+"),
    ],
)
def test_an_action_of_the_wrong_length_names_the_function(function, name) -> None:
    env = TransformedEnv(PointMass([2]), ResidualAction(FunctionController(function, KEYS)))
    with pytest.raises(ValueError, match=rf"^{name}: expected .* \(2, 2\), got \(2, 3\)"):
        env.reset()


class Broken(Exception):
    """It takes two arguments, and its text is made of both."""

    def __init__(self, joint, angle):
        super().__init__(joint, angle)

    def __str__(self):
        return "joint {} at {}".format(*self.args)


@pytest.mark.parametrize(
    ("fault", "kind", "text"),
    [
        (lambda: math.sqrt(-1.0), ValueError, r"^controller careless: .+"),
        (lambda: 1 / 0, ZeroDivisionError, "controller careless: division by zero"),
        (lambda: {}["gain"], KeyError, "controller careless: KeyError: 'gain'"),
        (lambda: exec("assert False"), AssertionError, "controller careless: AssertionError$"),
        (lambda: (_ for _ in ()).throw(Broken(3, 4)), RuntimeError, "careless: joint 3 at 4"),
    ],
)
def test_what_a_function_raises_names_it(fault, kind, text) -> None:
    def careless(position):
        fault()

    with pytest.raises(kind, match=text):
        FunctionController(careless, KEYS[:1]).act(state([2]))


def test_what_a_reset_raises_names_the_object() -> None:
    class Stuck(Scripted):
        def reset(self):
            raise RuntimeError("the gripper is closed")

    with pytest.raises(RuntimeError, match=r"^controller Stuck: the gripper is closed$"):
        FunctionController(Stuck, KEYS[:1]).act(state([2]))


def test_a_network_gets_tensors() -> None:
    controller = FunctionController(nn.Linear(2, 2), ["goal"])
    assert controller.act(state([])).shape == (2,)
    assert controller.outside_torch is None
