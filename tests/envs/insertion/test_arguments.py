"""What the environment takes, and how it refuses what does not fit."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from rrl.envs import InsertionEnv

DOWN = torch.tensor([0.0, 0.0, -1.0])


@pytest.mark.parametrize("seed", [-1, 0.5])
def test_seed_is_checked(seed: float) -> None:
    with pytest.raises(ValueError, match=f"seed: expected a whole number.* got {seed}"):
        InsertionEnv("sim", seed=seed)


def test_arguments_are_checked_without_building_physics(variant: str) -> None:
    sizes = InsertionEnv.check_arguments(variant, num_envs=4, yaw_range=0.1)
    spec = InsertionEnv(variant).observation_spec
    assert sizes == {name: spec[name].shape[-1] for name in sizes}
    with pytest.raises(ValueError, match=r"reward_weights: expected .*'tilt'.*got .*'tlit'"):
        InsertionEnv.check_arguments(variant, reward_weights={"tlit": 1.0})
    nothing = dict.fromkeys(("distance", "tilt", "displacement", "yaw"), 0.0)
    with pytest.raises(ValueError, match="reward_weights: expected one above 0"):
        InsertionEnv.check_arguments(variant, reward_weights=nothing)


@pytest.mark.parametrize("name", ["num_envs", "num_threads"])
@pytest.mark.parametrize("value", [0, -1, 1.5])
def test_sizes_are_checked(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected a whole number.* got {value}"):
        InsertionEnv("sim", **{name: value})


def test_numbers_may_be_numpys_and_actions_of_any_precision() -> None:
    env = InsertionEnv("sim", np.int64(2), np.int64(1), np.int64(3))
    same = InsertionEnv("sim", 2, 1, 3)
    assert torch.equal(env.reset()["blocks"], same.reset()["blocks"])
    steps = [
        e.step(TensorDict({"action": DOWN.expand(2, 3).to(t)}, [2]))
        for e, t in ((env, torch.bfloat16), (same, torch.float64))
    ]
    assert torch.equal(*(td["next", "blocks"] for td in steps))


def test_unknown_override_and_variant() -> None:
    with pytest.raises(ValueError, match=r"task settings: .* got 'yaw'"):
        InsertionEnv("sim", yaw=0.3)
    with pytest.raises(ValueError, match="variant: expected one of"):
        InsertionEnv("moon")


def test_bad_actions() -> None:
    env = InsertionEnv("sim", num_envs=3)
    env.reset()
    action = torch.zeros(3, 3)
    action[2, 1] = torch.nan
    with pytest.raises(ValueError, match=r"action: expected finite numbers, .*slot\(s\) \[2\]"):
        env.step(TensorDict({"action": action}, [3]))
    with pytest.raises(ValueError, match=r"action: expected shape \(3, 3\)"):
        env.step(TensorDict({"action": torch.zeros(3, 2)}, [3]))
