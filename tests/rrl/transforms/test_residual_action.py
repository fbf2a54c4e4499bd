"""The superposition: two passes, authority, specs, and what must be refused."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Bounded
from torchrl.envs import DMControlEnv, GymEnv, StepCounter, TransformedEnv, check_env_specs
from torchrl.envs.transforms import (
    Compose,
    DTypeCastTransform,
    ObservationNorm,
    VecNormV2,
)

from rrl.controllers import ReplayController, ZeroController
from rrl.transforms import ControlNoise, ResidualAction
from toy_envs import PointMass, ResetsItself
from transform_cases import (
    POSITION,
    drive,
    make_env,
    proportional,
    random_actions,
    residual_with_memory,
    with_memory,
)


class Recorder(PointMass):
    """Remembers the actions that reach it."""

    def __init__(self, *args, **kwargs) -> None:
        super().__init__(*args, **kwargs)
        self.executed: list[torch.Tensor] = []

    def _step(self, tensordict):
        self.executed.append(tensordict.get(self._key).clone())
        return super()._step(tensordict)


def run_controller_alone(env: PointMass, controller: nn.Module, steps: int) -> None:
    tensordict = env.reset()
    for _ in range(steps):
        tensordict = env.step(controller(tensordict).rename_key_("base_action", "action"))["next"]


@pytest.mark.parametrize("batch", [(), (1,), (3,)])
@pytest.mark.parametrize("make", [proportional, with_memory])
@pytest.mark.parametrize("how", ["zero action", "zero scale"])
def test_zero_residual_is_the_controller_bit_for_bit(make, how: str, batch: tuple) -> None:
    alone = Recorder(batch, seed=2)
    run_controller_alone(alone, make(), 15)
    inner = Recorder(batch, seed=2)
    scale = 0.0 if how == "zero scale" else 0.7
    env = TransformedEnv(inner, ResidualAction(make(), scale=scale))
    actions = random_actions(15, *batch, 2) * (how == "zero scale")
    drive(env, actions)
    for mine, theirs in zip(inner.executed, alone.executed, strict=True):
        assert torch.equal(mine, theirs)


def test_zero_residual_is_the_controller_under_the_same_noise() -> None:
    arms = []
    for controller, noise in (
        (proportional(), ControlNoise(0.2, 0.1, seed=4)),
        (ZeroController(2), ControlNoise(0.2, 0.1, seed=4)),
    ):
        inner = Recorder((2,), seed=2)
        env = TransformedEnv(inner, Compose(noise, ResidualAction(controller)))
        tensordict = env.reset()
        for _ in range(15):
            # One arm lets the transform act, the other says the controller's action itself.
            says_it = isinstance(controller, ZeroController)
            action = proportional().act(tensordict) if says_it else torch.zeros(2, 2)
            tensordict = env.step(tensordict.set("action", action))["next"]
        arms.append(inner.executed)
    for one, other in zip(*arms, strict=True):
        assert torch.equal(one, other)


def test_residual_is_added_scaled_and_clipped() -> None:
    inner = Recorder((1,))
    controller = ReplayController([[0.5, -0.5]])
    env = TransformedEnv(inner, ResidualAction(controller, scale=[0.2, 1.0]))
    drive(env, torch.tensor([[[1.0, 0.25]], [[-1.0, -1.0]]]))
    assert torch.allclose(inner.executed[0], torch.tensor([[0.7, -0.25]]))
    assert torch.allclose(inner.executed[1], torch.tensor([[0.3, -1.0]]))


def test_the_collector_stores_what_the_policy_said() -> None:
    env = make_env(residual_with_memory)
    actions = random_actions(5, 2)
    for record, action in zip(drive(env, actions)[1:], actions, strict=True):
        assert torch.equal(record["action"], action)


def test_bounds_that_are_not_one() -> None:
    inner = Recorder((), bound=4.0)
    env = TransformedEnv(inner, ResidualAction(ReplayController([[1.0, -3.0]]), scale=0.5))
    assert env.action_spec == Bounded(-1.0, 1.0, shape=(2,), device="cpu")
    drive(env, torch.tensor([[1.0, -1.0]]))
    assert torch.equal(inner.executed[0], torch.tensor([3.0, -4.0]))


def test_actuators_without_a_range_have_no_bounds() -> None:
    """dm_control gives them bounds of 1e10: a residual of 1 is one of their units, not 1e10."""
    env = TransformedEnv(
        DMControlEnv("lqr", "lqr_2_1"), ResidualAction(ZeroController(), scale=0.5)
    )
    limits = env.transform.limits()
    assert limits.half_range.tolist() == [1.0]
    assert not limits.high.isfinite().any() and not limits.low.isfinite().any()
    env.step(env.reset().set("action", torch.tensor([0.8], dtype=torch.float64)))
    assert env.base_env.physics.control().item() == pytest.approx(0.4)


def test_set_scale_counts_from_the_next_step() -> None:
    inner = Recorder(())
    env = TransformedEnv(inner, ResidualAction(ZeroController(2), scale=1.0))
    start = drive(env, torch.full((1, 2), 0.8))[-1]["next"].exclude("reward")
    env.transform.set_scale([0.5, 0.0])
    drive(env, torch.full((1, 2), 0.8), start=start)
    assert torch.equal(inner.executed[0], torch.tensor([0.8, 0.8]))
    assert torch.equal(inner.executed[1], torch.tensor([0.4, 0.0]))


def test_a_residual_can_solve_what_the_controller_cannot() -> None:
    env = TransformedEnv(PointMass([4]), ResidualAction(proportional()))

    def success(residual: list[float]) -> torch.Tensor:
        action = torch.tensor(residual).expand(4, 2)
        return env.rollout(20, lambda td: td.set("action", action))["next", "success"][:, -1]

    assert not success([0.0, 0.0]).any()
    assert success([-0.6, 0.0]).all()


def test_a_later_normalizer_does_not_reach_the_controller() -> None:
    def records(*later):
        return drive(
            TransformedEnv(PointMass(), Compose(ResidualAction(proportional()), *later)),
            random_actions(10, 2),
        )

    plain = records()
    normalized = records(ObservationNorm(loc=3.0, scale=0.1, in_keys=[POSITION]))
    for one, other in zip(plain, normalized, strict=True):
        assert torch.equal(one["base_action"], other["base_action"])
        assert not torch.equal(one[POSITION], other[POSITION])


@pytest.mark.parametrize(
    "make",
    [
        partial(ObservationNorm, loc=0.3, scale=5.0, in_keys=["base_action"]),
        partial(VecNormV2, in_keys=[POSITION, "base_action"]),
    ],
)
def test_a_normalizer_may_not_change_what_is_executed(make) -> None:
    env = TransformedEnv(PointMass(), Compose(ResidualAction(proportional()), make()))
    with pytest.raises(RuntimeError, match="'base_action': expected what the controller said"):
        env.reset()


def test_a_normalizer_may_show_the_base_action_as_another_entry() -> None:
    norm = ObservationNorm(loc=0.3, scale=5.0, in_keys=["base_action"], out_keys=["seen"])
    casts = DTypeCastTransform(torch.float32, torch.float64, in_keys=["base_action"])
    later = Compose(ResidualAction(proportional(), scale=0.0), norm, casts)
    env = TransformedEnv(Recorder(), later)
    tensordict = env.step(env.reset().set("action", torch.ones(2)))
    assert torch.equal(env.base_env.executed[-1].double(), tensordict["base_action"])
    assert not torch.equal(tensordict["seen"], tensordict["base_action"])


def test_an_earlier_normalizer_does() -> None:
    norm = ObservationNorm(loc=0.1, scale=1.0, in_keys=[POSITION])
    shifted = TransformedEnv(PointMass(), Compose(norm, ResidualAction(proportional()))).reset()
    plain = TransformedEnv(PointMass(), ResidualAction(proportional())).reset()
    assert torch.allclose(shifted[POSITION], plain[POSITION] + 0.1)
    assert not torch.equal(shifted["base_action"], plain["base_action"])


def test_nested_action() -> None:
    inner = Recorder((2,), action_key=("arm", "action"))
    transform = ResidualAction(proportional(), scale=0.5, action_key=("arm", "action"))
    env = TransformedEnv(inner, transform)
    check_env_specs(env)
    tensordict = env.reset()
    assert ("arm", "base_action") in tensordict.keys(True)
    inner.executed.clear()
    env.step(tensordict.set(("arm", "action"), torch.zeros(2, 2)))
    assert torch.equal(inner.executed[0], tensordict["arm", "base_action"])


@pytest.mark.parametrize("scale", [0.0, 0.5])
def test_pendulum_of_gymnasium(scale: float) -> None:
    layer = nn.Linear(3, 1)
    policy = TensorDictModule(layer, in_keys=["observation"], out_keys=["action"])
    noise = ControlNoise(mu=0.1, sigma=0.0, seed=0)
    env = TransformedEnv(
        GymEnv("Pendulum-v1"), Compose(noise, ResidualAction(policy, scale), StepCounter(30))
    )
    check_env_specs(env)
    rollout = env.rollout(60, break_when_any_done=False)
    expected = rollout["base_action"] + scale * 2.0 * rollout["action"]
    expected = torch.clamp(torch.clamp(expected, -2.0, 2.0) + 0.1 * 2.0, -2.0, 2.0)
    assert torch.allclose(rollout["next", "executed_action"], expected)
    assert not rollout["base_action"].requires_grad


def test_float64_environment_with_a_float32_controller() -> None:
    env = GymEnv("Pendulum-v1")
    env.full_action_spec = env.full_action_spec.to(torch.float64)
    transformed = TransformedEnv(env, ResidualAction(ZeroController(1)))
    assert transformed.action_spec.dtype == torch.float64
    assert transformed.reset()["base_action"].dtype == torch.float64


def test_environment_that_resets_itself() -> None:
    def chain() -> Compose:
        return Compose(ControlNoise(0.1, 0.2, seed=0), ResidualAction(with_memory()))

    own = TransformedEnv(ResetsItself((2,), episode_steps=5), chain())
    own.__dict__["_torchrl_native_autoreset"] = True
    usual = TransformedEnv(PointMass((2,), episode_steps=5), chain())
    actions = random_actions(12, 2, 2)
    one, other = own.reset(), usual.reset()
    for action in actions:
        _, one = own.step_and_maybe_reset(one.set("action", action))
        _, other = usual.step_and_maybe_reset(other.set("action", action))
        assert torch.equal(one["base_action"], other["base_action"])
        assert torch.equal(one["executed_action"], other["executed_action"])


def test_a_second_residual_under_another_key() -> None:
    two = Compose(
        ResidualAction(proportional()),
        ResidualAction(ZeroController(2), base_action_key="second_base_action"),
    )
    check_env_specs(TransformedEnv(PointMass(), two))


class WritesIntoWhatItReads(ZeroController):
    """Subtracts in place."""

    def act(self, tensordict):
        goal = self.read(tensordict, "goal")
        goal -= 100.0
        return torch.zeros_like(goal)


def test_what_a_controller_writes_into_an_entry_reaches_nobody_else() -> None:
    env = TransformedEnv(PointMass([]), ResidualAction(WritesIntoWhatItReads(2)))
    assert env.reset()["goal"].abs().max() < 10.0
