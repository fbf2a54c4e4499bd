"""A NaN from policy, controller or sensor: a safe command in the same step, and the end."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import SerialEnv, TransformedEnv
from torchrl.envs.transforms import Compose, Transform

from rrl.controllers import Controller, PIDController, ReplayController
from rrl.transforms import (
    ControlNoise,
    FiniteAction,
    ForceLimit,
    ResidualAction,
    StepLimit,
    WorkspaceLimit,
)
from toy_envs import PointMass, ResetsItself
from transform_cases import POSITION, drive

NAN = math.nan
BAD = pytest.mark.parametrize("bad", [NAN, math.inf, -math.inf])


class Recorder(PointMass):
    """Remembers the actions that reach it."""

    def __init__(self, *args, **kwargs) -> None:
        super().__init__(*args, **kwargs)
        self.executed: list[torch.Tensor] = []

    def _step(self, tensordict):
        self.executed.append(tensordict.get("action").clone())
        return super()._step(tensordict)


class Breaks(Transform):
    """A sensor of the position that gives ``value`` from step ``start`` on, in slot 0."""

    def __init__(self, start: int, stop: int = 99, value: float = NAN) -> None:
        super().__init__()
        self.steps, self.range, self.value = 0, range(start, stop), value

    def _reset(self, tensordict, tensordict_reset):
        return tensordict_reset

    def _call(self, next_tensordict):
        self.steps += 1
        position = next_tensordict[POSITION].clone()
        if self.steps in self.range:
            position[0] = self.value
        return next_tensordict.set(POSITION, position)


def chain(*transforms, **options) -> tuple[Recorder, TransformedEnv]:
    inner = Recorder((2,), **options)
    return inner, TransformedEnv(inner, Compose(*transforms))


@BAD
@pytest.mark.parametrize("replacement", ["last", "zero", "controller"])
def test_a_policy_that_breaks(replacement: str, bad: float) -> None:
    """Slot 0 gets its replacement, slot 1 does what it is told."""
    finite = FiniteAction(replacement, truncate=False)
    inner, env = chain(finite, ResidualAction(ReplayController([[0.1, 0.2], [0.3, 0.4]]), 0.5))
    actions = torch.full((2, 2, 2), 0.5)
    actions[1, 0, 1] = bad
    records = drive(env, actions)
    expected = {"last": [0.35, 0.45], "zero": [0.0, 0.0], "controller": [0.3, 0.4]}
    if math.isinf(bad):  # superposition clips it at the action's own bounds
        expected = {name: [0.55, math.copysign(1.0, bad)] for name in expected}
    assert torch.allclose(inner.executed[1][0], torch.tensor(expected[replacement]))
    assert torch.allclose(inner.executed[1][1], torch.tensor([0.55, 0.65]))
    flags = [record["next", "safety", "finite"].flatten().tolist() for record in records[1:]]
    assert flags == [[False, False], [math.isnan(bad), False]]
    assert not records[2]["next", "done"].any()


@BAD
def test_without_bounds_of_the_action_infinity_counts_too(bad: float) -> None:
    finite = FiniteAction("zero")
    finite._take_limits = lambda spec: None  # not attached: the method alone is tested
    action = torch.tensor([[0.5, bad], [0.5, 1e30]])
    assert finite.changed(action, action).tolist() == [[True], [False]]


class Broken(Controller):
    """A controller that gives NaN."""

    def act(self, tensordict):
        return torch.full_like(self.read(tensordict, POSITION), NAN)


@pytest.mark.parametrize("replacement", ["last", "zero", "controller"])
def test_a_controller_that_breaks_in_the_first_step(replacement: str) -> None:
    inner, env = chain(FiniteAction(replacement), ControlNoise(0.1), ResidualAction(Broken([])))
    record = drive(env, torch.zeros(1, 2, 2))[1]["next"]
    assert torch.equal(inner.executed[0], torch.zeros(2, 2))
    assert torch.equal(record["executed_action"], torch.zeros(2, 2))
    assert record["safety", "finite"].all() and record["truncated"].all() and record["done"].all()
    assert not record["terminated"].any()


def test_any_module_as_the_controller() -> None:
    module = TensorDictModule(lambda x: x * NAN, in_keys=["goal"], out_keys=["base_action"])
    inner, env = chain(FiniteAction(), ResidualAction(module))
    assert drive(env, torch.zeros(1, 2, 2))[1]["next", "truncated"].all()
    assert inner.executed[0].isfinite().all()


def test_a_controller_that_remembers_a_nan_starts_anew() -> None:
    """The sensor breaks for one step; its slot ends, its neighbor does not notice."""
    pid = PIDController(gain=0.3, integral_gain=0.5)
    inner, env = chain(FiniteAction(), Breaks(3, 4), ResidualAction(pid))
    zeros = torch.zeros(2, 2)
    rollout = env.rollout(10, lambda td: td.set("action", zeros), break_when_any_done=False)
    assert all(action.isfinite().all() for action in inner.executed)
    flags = rollout["next", "safety", "finite"].squeeze(-1)
    assert flags.sum(1).tolist() == [1, 0]
    assert torch.equal(rollout["next", "done"].squeeze(-1), flags)
    assert rollout["base_action"].isfinite().all(-1).sum(1).tolist() == [9, 10]


def test_steps_of_one_slot_end_no_other_slot() -> None:
    _, env = chain(FiniteAction(), ResidualAction(Broken([])))
    td = env.reset().set("action", torch.zeros(2, 2)).set("_step", torch.tensor([True, False]))
    assert env.step(td)["next", "truncated"].flatten().tolist() == [True, False]


def test_in_serial_and_in_an_environment_that_resets_itself() -> None:
    def make(env=None):
        env = PointMass() if env is None else env
        return TransformedEnv(env, Compose(FiniteAction(), ResidualAction(Broken([]))))

    def step(env):
        return env.step(env.rand_action(env.reset()))["next"]

    assert step(SerialEnv(2, make))["truncated"].all()
    assert step(make(SerialEnv(2, PointMass)))["truncated"].all()
    following = step(make(ResetsItself((2,))))
    assert not following["done"].any()  # it cannot be told to end an episode
    assert following[POSITION].isfinite().all()


def test_nested_actions() -> None:
    key = ("arm", "action")
    transforms = FiniteAction(action_key=key), ResidualAction(Broken([]), action_key=key)
    env = TransformedEnv(PointMass([2], action_key=key), Compose(*transforms))
    td = env.step(env.reset().set(key, torch.zeros(2, 2)))["next"]
    assert td["arm", "safety", "finite"].all() and td["done"].all()


LIMITS = {
    "workspace": lambda: WorkspaceLimit(-5.0, 5.0, unit=0.1),
    "force": lambda: ForceLimit(50.0, 1.0, force_key=POSITION, axes=[0, 1], retract=0.5),
    "step": lambda: StepLimit(size=0.5, change=0.5),
}


@BAD
@pytest.mark.parametrize("name", ["workspace", "force"])
def test_a_measurement_that_is_not_finite_stops_the_motion(name: str, bad: float) -> None:
    """The command is fine, the sensor is not: nobody knows where the motion would lead."""
    inner, env = chain(Breaks(2, 3, bad), LIMITS[name]())
    records = drive(env, torch.full((4, 2, 2), 0.3))
    moved = [bool((action[0] != 0).all()) for action in inner.executed]
    assert moved == [True, True, False, True]
    assert all(torch.equal(action[1], torch.full((2,), 0.3)) for action in inner.executed)
    flags = torch.stack([record["next", "safety", name] for record in records[1:]]).squeeze(-1)
    assert flags.tolist() == [[False, False], [False, False], [True, False], [False, False]]


@pytest.mark.parametrize(("name", "held"), [("workspace", 0.0), ("force", 0.0), ("step", 0.3)])
def test_a_limit_alone_lets_no_nan_pass(name: str, held: float) -> None:
    inner, env = chain(LIMITS[name]())
    actions = torch.full((2, 2, 2), 0.3)
    actions[1, 0, 0] = NAN
    record = drive(env, actions)[2]
    assert torch.equal(inner.executed[1], torch.tensor([[held, held], [0.3, 0.3]]))
    assert record["next", "safety", name].flatten().tolist() == [True, False]


def test_the_other_limits_have_the_last_word() -> None:
    """What was executed last leads out of the box by now; a change of the command is bounded."""
    limits = WorkspaceLimit(-9.0, 0.2, unit=0.1), StepLimit(change=0.4), FiniteAction("last")
    inner, env = chain(*limits, drift=0.0, episode_steps=99)
    actions = torch.full((20, 2, 2), 1.0)
    actions[5:] = NAN
    records = drive(env, actions)
    assert torch.stack(inner.executed).isfinite().all()
    assert max(record["next", POSITION].max() for record in records[15:]) <= 0.2 + 1e-6


def test_where_the_scale_is_zero_a_broken_policy_does_not_count() -> None:
    inner, env = chain(FiniteAction(), ResidualAction(ReplayController([[0.1, 0.2]]), [0.0, 0.0]))
    record = drive(env, torch.full((1, 2, 2), NAN))[1]
    assert torch.equal(inner.executed[0], torch.tensor([[0.1, 0.2]] * 2))
    assert not record["next", "safety", "finite"].any()


def test_a_bad_replacement_is_named() -> None:
    with pytest.raises(ValueError, match=r"replacement: expected one of last, .* got 'first'"):
        FiniteAction("first")
