"""The eleven ways in which TorchRL tests a transform, for every transform of ours."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import EnvBase, ParallelEnv, SerialEnv, TransformedEnv, check_env_specs
from torchrl.envs.transforms import Compose

from toy_envs import PointMass
from transform_cases import (
    CASES,
    POSITION,
    Factory,
    assert_same,
    control_noise,
    drive,
    latency,
    make_env,
    observation_noise,
    random_actions,
    residual_with_memory,
    safe_residual,
)

WORKERS = 2
TIMED = {
    "latency",
    "tracker",
    "outages",
    "chain",
    "action_history",
    "residual_history",
    "operated",
    "judged_success",
    "episode_value",
    "finite_observation",
}  # cases that need an order in time
LIMITS = {"workspace_limit", "step_limit", "force_limit", "finite_action", "safe_residual"}
RESIDUALS = {
    *("residual", "residual_with_memory", "residual_with_plan", "residual_on_policy"),
    *("residual_history", "operated", "chain"),
}
ON_ACTIONS = {"control_noise"} | RESIDUALS | LIMITS
OF_STEPS = {
    "executed_action",
    "intervention",
    "safety",
}  # records of a step, which data without an environment has none of

each_case = pytest.mark.parametrize("name", CASES)


@pytest.fixture(scope="module")
def workers() -> Iterator[ParallelEnv]:
    """One pool of plain environments for all tests: starting one takes seconds."""
    env = ParallelEnv(WORKERS, partial(PointMass, seed=None), mp_start_method="spawn")
    yield env
    env.close(raise_if_closed=False)


def no_env_data(steps: int = 5) -> TensorDict:
    position = torch.linspace(-0.3, 0.4, steps * 2).reshape(steps, 2)
    data = {POSITION: position, "goal": torch.zeros(steps, 2), "action": torch.zeros(steps, 2)}
    return TensorDict(data, batch_size=[steps])


@each_case
@pytest.mark.parametrize("batch", [(), (1,), (3,), (2, 3)])
def test_single(name: str, batch: tuple[int, ...]) -> None:
    check_env_specs(make_env(CASES[name], batch))


@each_case
def test_serial_of_transformed(name: str) -> None:
    check_env_specs(SerialEnv(WORKERS, partial(make_env, CASES[name])))
    check_env_specs(SerialEnv(WORKERS, partial(make_env, CASES[name], (3,))))


@pytest.mark.parametrize(
    "factory",
    [
        residual_with_memory,
        *(
            pytest.param(factory, marks=pytest.mark.slow)
            for factory in (control_noise, observation_noise, latency, safe_residual)
        ),
    ],
)
def test_parallel_of_transformed(factory: Factory) -> None:
    env = ParallelEnv(WORKERS, partial(make_env, factory, seed=None), mp_start_method="spawn")
    actions = random_actions(25, WORKERS, 2)
    try:
        check_env_specs(env)
        recordings = []
        for _ in range(2):
            env.set_seed(3)
            recordings.append(drive(env, actions))
        assert_same(*recordings)
        first, second = recordings[0][-1].unbind(0)
        assert not torch.equal(first["next", POSITION], second["next", POSITION])
    finally:
        env.close(raise_if_closed=False)


@each_case
def test_transformed_serial(name: str) -> None:
    env = TransformedEnv(SerialEnv(WORKERS, PointMass), CASES[name](0))
    check_env_specs(env)
    nested = TransformedEnv(SerialEnv(WORKERS, partial(PointMass, (3,))), CASES[name](0))
    check_env_specs(nested)


@each_case
def test_transformed_parallel(name: str, workers: ParallelEnv) -> None:
    env: EnvBase = TransformedEnv(workers, CASES[name](0))
    check_env_specs(env)
    rollout = env.rollout(45, break_when_any_done=False)
    assert rollout.batch_size == (WORKERS, 45)
    assert all(value.isfinite().all() for value in rollout.values(True, True))


def expect_without_env(name: str, transform: nn.Module) -> None:
    data = no_env_data()
    if name in TIMED:
        with pytest.raises(RuntimeError, match="order in time"):
            transform(data)
        return
    before = data.clone()
    after = transform(data.clone())
    for key in transform.out_keys:
        if (key if isinstance(key, str) else key[0]) not in OF_STEPS:
            assert after.get(key).isfinite().all()
    written = {str(key) for key in transform.out_keys}
    for key in before.keys(True, True):
        assert key in written or torch.equal(before[key], after[key])


@each_case
def test_no_env(name: str) -> None:
    expect_without_env(name, CASES[name](0))


@each_case
def test_compose(name: str) -> None:
    compose = Compose(CASES[name](0), CASES["observation_noise"](0))
    data = no_env_data()
    if name in TIMED:
        with pytest.raises(RuntimeError, match="order in time"):
            compose(data)
    else:
        assert not torch.equal(compose(data.clone())[POSITION], data[POSITION])


@each_case
def test_env(name: str) -> None:
    env = make_env(CASES[name], (2,))
    start = env.reset()
    out_keys = set(map(str, env.observation_spec.keys(True, True)))
    assert out_keys <= set(map(str, start.keys(True, True)))
    start["action"] = torch.zeros(2, 2)
    step = env.step(start)
    assert out_keys <= set(map(str, step["next"].keys(True, True)))
    assert env.observation_spec.is_in(step["next"].select(*env.observation_spec.keys(True, True)))


@each_case
def test_model(name: str) -> None:
    transform = CASES[name](0)
    reader = TensorDictModule(nn.Linear(2, 1), in_keys=[POSITION], out_keys=["value"])
    if name in TIMED:
        with pytest.raises(RuntimeError, match="order in time"):
            nn.Sequential(transform, reader)(no_env_data())
    else:
        out = nn.Sequential(transform, TensorDictSequential(reader))(no_env_data())
        assert out["value"].shape == (5, 1)


@each_case
def test_replay_buffer(name: str) -> None:
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(10), batch_size=4)
    buffer.append_transform(CASES[name](0))
    if name in ON_ACTIONS:
        with pytest.raises(RuntimeError, match="attached to none"):
            buffer.extend(no_env_data())
        return
    buffer.extend(no_env_data())
    if name in TIMED:
        with pytest.raises(RuntimeError, match="order in time"):
            buffer.sample()
    else:
        out = buffer.sample()
        # Stored as it was given, noisy in the sample.
        assert torch.equal(buffer.storage[:5][POSITION], no_env_data()[POSITION])
        assert all(out.get(key).isfinite().all() for key in CASES[name](0).out_keys)


@each_case
def test_inverse(name: str) -> None:
    data = no_env_data()
    if name in ON_ACTIONS:
        with pytest.raises(RuntimeError, match="attached to none"):
            CASES[name](0).inv(data)
    else:
        out = CASES[name](0).inv(data)
        assert all(torch.equal(out[key], data[key]) for key in data.keys(True, True))
