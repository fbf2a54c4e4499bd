"""Entries of any precision, shape and name: they work, or the message names the entry."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, RenameTransform, TransformedEnv, check_env_specs
from torchrl.envs.transforms import Compose, DoubleToFloat

from rrl.controllers import (
    Controller,
    PIDController,
    PolicyController,
    ProportionalController,
    ReplayController,
    SumController,
    ZeroController,
)
from rrl.keys import SO_FAR
from rrl.transforms import (
    ActionHistory,
    ControlNoise,
    EpisodeValue,
    FiniteAction,
    ForceLimit,
    ObservationLatency,
    ObservationNoise,
    ResidualAction,
    StepLimit,
    WorkspaceLimit,
)
from toy_envs import PointMass
from transform_cases import CASES, POSITION, Plan, drive, random_actions


class Precise(PointMass):
    """A point whose action and observations have another precision, and which insists on it."""

    def __init__(self, batch=(), dtype=torch.float64) -> None:
        super().__init__(batch)
        self.precision = dtype
        for name in ("full_action_spec", "full_observation_spec"):
            specs = getattr(self, name)
            for key, spec in list(specs.items(True, True)):
                if spec.dtype.is_floating_point:
                    specs[key] = spec.to(dtype)
            setattr(self, name, specs)

    def _cast(self, out):
        keys = (POSITION, "goal")
        return out.update({key: out[key].to(self.precision) for key in keys})

    def _reset(self, tensordict=None, **kwargs):
        return self._cast(super()._reset(tensordict, **kwargs))

    def _step(self, tensordict):
        assert tensordict["action"].dtype == self.precision
        tensordict = tensordict.clone(False).set("action", tensordict["action"].float())
        return self._cast(super()._step(tensordict))


OBSERVERS = {
    "observation_noise",
    "observation_noise_beside",
    "latency",
    "tracker",
    "outages",
    "action_history",
    "episode_value",
    "finite_observation",
    "judged_success",
}
"""Transforms that leave the action as it is, precision included."""


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16])
@pytest.mark.parametrize("name", CASES)
def test_precision_of_every_transform(name: str, dtype: torch.dtype) -> None:
    env = TransformedEnv(Precise([2], dtype), CASES[name](0))
    check_env_specs(env)
    actions = random_actions(8, 2, 2)  # a policy in float32
    for record in drive(env, actions.to(dtype) if name in OBSERVERS else actions):
        for key in env.observation_spec.keys(True, True):
            kept = torch.float32 if key[0] == SO_FAR else dtype  # a sum needs the digits
            for value in (record.get(key), record.get(("next", key), None)):
                assert value is None or value.dtype in (kept, torch.bool), key


def network() -> PolicyController:
    layer = nn.Linear(2, 2)
    return PolicyController(TensorDictModule(layer, in_keys=[POSITION], out_keys=["action"]))


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16])
@pytest.mark.parametrize(
    "controller",
    [
        ProportionalController(gain=[0.5, 0.4], clip=[0.1, 0.2], unit=0.1),
        PIDController(gain=[0.5, 0.4], integral_gain=[0.1, 0.1], clip=[0.1, 0.2]),
        ReplayController([[0.1, 0.2]] * 3),
        ZeroController(),
        SumController([ZeroController(), Plan()], weights=[[1.0, 1.0], 0.5], clip=[0.1, 0.2]),
        network(),
    ],
    ids=lambda controller: type(controller).__name__,
)
def test_precision_of_every_controller(controller, dtype: torch.dtype) -> None:
    env = TransformedEnv(Precise([2], dtype), ResidualAction(controller, scale=[0.1, 0.2]))
    check_env_specs(env)
    records = drive(env, random_actions(4, 2, 2).to(dtype))
    assert {record["next", "base_action"].dtype for record in records[1:]} == {dtype}


def test_double_precision_is_kept() -> None:
    """Parameters and actions are not rounded to float32 on their way."""
    executed = []

    class Recorder(Precise):
        def _step(self, tensordict):
            executed.append(tensordict["action"].clone())
            return super()._step(tensordict)

    recorded = torch.tensor([[0.1, -0.3]], dtype=torch.float64)
    noise = ControlNoise(mu=0.1)
    env = TransformedEnv(
        Recorder(), Compose(noise, ResidualAction(ReplayController(recorded), 0.7))
    )
    drive(env, torch.tensor([[0.2, 0.3]], dtype=torch.float64))
    expected = torch.tensor([0.1 + 0.14 + 0.1, -0.3 + 0.21 + 0.1], dtype=torch.float64)
    torch.testing.assert_close(executed[0], expected, rtol=0.0, atol=1e-15)


class Scalar(EnvBase):
    """An environment of which an action or an observation is one number without a dimension."""

    def __init__(self, batch=(), *, action=(), force=(2,)) -> None:
        super().__init__(batch_size=batch)
        self.shapes = {"force": (*batch, *force), "position": (*batch, 2)}
        specs = {key: Unbounded(shape) for key, shape in self.shapes.items()}
        self.observation_spec = Composite(specs, shape=batch)
        self.full_action_spec = Composite(
            {"action": Bounded(-1.0, 1.0, (*batch, *action))}, shape=batch
        )
        self.reward_spec = Unbounded((*batch, 1))

    def _reset(self, tensordict=None, **kwargs):
        zeros = {key: torch.zeros(shape) for key, shape in self.shapes.items()}
        return TensorDict(zeros, self.batch_size)

    def _step(self, tensordict):
        out = self._reset()
        out["reward"] = torch.zeros(*self.batch_size, 1)
        out["done"] = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        return out

    def _set_seed(self, seed): ...


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize(
    "transform",
    [
        *(ActionHistory, ControlNoise, FiniteAction, lambda: StepLimit(0.5)),
        lambda: ResidualAction(ZeroController()),
    ],
)
def test_an_action_without_a_dimension_is_named(transform, batch) -> None:
    with pytest.raises(ValueError, match=r"'action': expected an action of shape \[\*batch, n\]"):
        TransformedEnv(Scalar(batch), transform()).reset()


@pytest.mark.parametrize("batch", [(), (3,)])
def test_a_measurement_without_a_dimension_is_named(batch) -> None:
    env = TransformedEnv(
        Scalar(batch, action=(2,), force=()), ForceLimit(1.0, 1.0, force_key="force", axes=[0])
    )
    with pytest.raises(ValueError, match=r"'force': expected an observation of shape \[\*batch, n"):
        env.observation_spec  # noqa: B018 - computing it is the test


@pytest.mark.parametrize("batch", [(), (3,)])
def test_an_observation_without_a_dimension_can_be_noisy_and_late(batch) -> None:
    faults = ObservationNoise(["force"], sigma=[0.1], seed=0), ObservationLatency(["force"], 2)
    env = TransformedEnv(Scalar(batch, action=(2,), force=()), Compose(*faults))
    check_env_specs(env)
    assert env.rollout(4)["next", "force"].unique().numel() > 1


@pytest.mark.parametrize("batch", [(), (3,)])
def test_a_controller_that_reads_numbers_without_a_dimension(batch) -> None:
    env = Scalar(batch, action=(2,), force=())
    controller = ProportionalController("force", "force")
    with pytest.raises(ValueError, match="ProportionalController: expected an action of shape"):
        TransformedEnv(env, ResidualAction(controller)).reset()
    with pytest.raises(ValueError, match="gain: expected one number or 1"):
        ProportionalController("force", "force", gain=[1.0, 1.0]).act(Scalar((), force=()).reset())


def test_a_cast_hides_nothing_of_what_a_limit_nearer_to_the_environment_has_changed() -> None:
    limits = StepLimit(size=0.2), FiniteAction(truncate=False)
    env = TransformedEnv(Precise([1]), Compose(DoubleToFloat(), *limits, ControlNoise()))
    actions = torch.tensor([[[1.0, 1.0]], [[torch.nan, 0.0]]])
    for record in drive(env, actions)[1:]:
        torch.testing.assert_close(record["next", "executed_action"], torch.full((1, 2), 0.2))


@pytest.mark.parametrize("name", ["arm/position", ("arm", "position"), ("arm/left", "pos/x")])
def test_slashes_and_nested_names(name) -> None:
    """Names of ROS topics, of dm_control's composer, and of nested observations."""
    plain, named = [], []
    for key, records in ((POSITION, plain), (name, named)):
        renamed = [] if key == POSITION else [RenameTransform([POSITION], [key], create_copy=False)]
        controllers = [ProportionalController(key), PIDController(key, integral_gain=0.1)]
        chain = Compose(
            *renamed,
            WorkspaceLimit(-5.0, 5.0, position_key=key),
            ForceLimit(5.0, 1.0, force_key=key, axes=[0, 1]),
            StepLimit(0.9, 0.5),
            FiniteAction(),
            ObservationNoise([key], bias=0.05, seed=0),
            ObservationLatency([key], 1, seed=0, out_keys=[("late", "x/y")]),
            ResidualAction(SumController(controllers), 0.5),
        )
        env = TransformedEnv(PointMass([2]), chain)
        check_env_specs(env)
        env.load_state_dict(env.state_dict())
        records += [record["base_action"] for record in drive(env, random_actions(5, 2, 2))]
    assert all(torch.equal(one, other) for one, other in zip(plain, named, strict=True))


def test_values_of_two_entries_of_the_same_name_are_refused() -> None:
    with pytest.raises(ValueError, match=r"reductions: expected keys whose last parts differ"):
        EpisodeValue({("left", "force"): "max", ("right", "force"): "sum"})


def test_one_name_instead_of_a_list() -> None:
    class Reads(ZeroController):
        def __init__(self, in_keys) -> None:
            super().__init__(2)
            Controller.__init__(self, in_keys)

    assert Reads("goal").in_keys == ["goal"]
    assert Reads([("a", ("b", "c"))]).in_keys == [("a", "b", "c")]


def test_what_an_episode_came_to_is_single_precision_whatever_the_default_is() -> None:
    torch.set_default_dtype(torch.float64)
    try:
        env = TransformedEnv(PointMass([2]), EpisodeValue({"success": "sum"}))
        check_env_specs(env)
    finally:
        torch.set_default_dtype(torch.float32)
