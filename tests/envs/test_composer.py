from __future__ import annotations

import pytest
import torch
from dm_control import manipulation, suite
from torchrl.envs import SerialEnv
from torchrl.envs.utils import check_env_specs

from rrl.envs import NAMES, ComposerEnv, InsertionEnv, load


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", NAMES)
def test_insertion(name: str, dtype: torch.dtype) -> None:
    env = ComposerEnv(load(name), seed=0, dtype=dtype)
    check_env_specs(env)
    assert env.batch_size == torch.Size([])
    types = {spec.dtype for spec in env.specs.values(True, True)}
    assert types == {dtype, torch.bool}
    rollout = env.rollout(100)
    assert rollout.shape == (50,)
    assert rollout["next", "truncated"][-1].all()
    assert not rollout["next", "terminated"].any()


@pytest.mark.parametrize("name", NAMES)
def test_keys_are_those_of_the_batched_environment(name: str) -> None:
    env = ComposerEnv(load(name))
    batch = InsertionEnv(name.removeprefix("insertion-"))
    keys = set(env.observation_spec.keys(True, True))
    assert keys == set(batch.observation_spec.keys(True, True))
    for key in keys:
        assert env.observation_spec[key].dtype == batch.observation_spec[key].dtype
        assert env.observation_spec[key].shape == batch.observation_spec[key].shape[1:]


def test_double_precision_keeps_what_single_rounds() -> None:
    single, double = (
        ComposerEnv(load("insertion-sim"), seed=2, dtype=dtype).reset()
        for dtype in (torch.float32, torch.float64)
    )
    assert (single["blocks"] != double["blocks"]).any()
    assert torch.equal(single["blocks"], double["blocks"].float())


def test_any_composer_environment() -> None:
    env = ComposerEnv(manipulation.load("reach_duplo_features"), seed=0)
    check_env_specs(env)
    assert env.action_spec.dtype == torch.float32
    assert env.rollout(3)["jaco_arm/joints_pos"].dtype == torch.float32


def test_seed_reproduces_resets() -> None:
    env = ComposerEnv(load("insertion-real"))
    env.set_seed(4)
    first = [env.reset()["blocks"] for _ in range(2)]
    env.set_seed(4)
    for blocks in first:
        assert torch.equal(env.reset()["blocks"], blocks)


def make_env() -> ComposerEnv:
    return ComposerEnv(load("insertion-sim"))


def test_several_in_one() -> None:
    env = SerialEnv(2, make_env)
    env.set_seed(0)
    assert env.rollout(2).shape == (2, 2)
    env.close()


def test_needs_a_composer_environment() -> None:
    with pytest.raises(TypeError, match=r"env: expected a dm_control\.composer\.Environment"):
        ComposerEnv(suite.load("cartpole", "swingup"))
