"""Transforms of TorchRL that take steps of their own, beside every transform of ours."""

from __future__ import annotations

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import (
    Compose,
    ConditionalPolicySwitch,
    FrameSkipTransform,
    MultiAction,
    NoopResetEnv,
)

from toy_envs import PointMass
from transform_cases import CASES, assert_same, drive, make_env, random_actions

STEPPERS = {
    "FrameSkipTransform": lambda: FrameSkipTransform(2),
    "NoopResetEnv": lambda: NoopResetEnv(3, random=False),
    "MultiAction": MultiAction,
    "ConditionalPolicySwitch": lambda: ConditionalPolicySwitch(
        TensorDictModule(torch.zeros_like, ["goal"], ["action"]), lambda td: torch.tensor(False)
    ),
}

each_case = pytest.mark.parametrize("name", CASES)


@each_case
@pytest.mark.parametrize("stepper", STEPPERS)
def test_behind_ours_they_are_refused(name: str, stepper: str) -> None:
    """They would step copies of ours: limits, delays and controllers would miss these steps."""
    env = TransformedEnv(PointMass(), Compose(CASES[name](0), STEPPERS[stepper]()))
    with pytest.raises(RuntimeError, match=f"got a {stepper} behind it.*put the {stepper}"):
        env.reset()


@each_case
@pytest.mark.parametrize("stepper", ["FrameSkipTransform", "NoopResetEnv"])
def test_in_front_of_ours_they_are_part_of_the_environment(name: str, stepper: str) -> None:
    chain = Compose(STEPPERS[stepper](), *Compose(CASES[name](0)))
    assert TransformedEnv(PointMass(), chain).rollout(3).shape == (3,)


@each_case
def test_around_ours_several_actions_are_steps_like_others(name: str) -> None:
    actions = random_actions(6, 2)
    expected = drive(make_env(CASES[name]), actions)
    around = TransformedEnv(make_env(CASES[name]), MultiAction(), auto_unwrap=False)
    found = drive(around, actions.reshape(3, 2, 2))
    for both in (*found, *expected):  # of each of the two actions there, of the last one here
        for key in ("action", ("next", "reward")):
            both.pop(key, None)
    assert_same([td["next"] for td in found[1:]], [td["next"] for td in expected[2::2]])
