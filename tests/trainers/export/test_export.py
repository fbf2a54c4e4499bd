"""What an export holds, and what stays outside."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
import torch
from torchrl.data import Binary, Bounded, Categorical, MultiOneHot, OneHot, Unbounded
from torchrl.envs import GymEnv

from agents import random_policy
from benchmarks.deploy.episodes import trainers_episode
from exports import KEYS, point
from rrl.controllers import Controller, StatefulController, ZeroController
from rrl.deploy import Policy, read_contract
from rrl.trainers.descriptions import named
from rrl.trainers.environment import EnvironmentFactory, Input
from rrl.trainers.evaluation.rollout import zero_residual
from rrl.trainers.export.folder import export_policy
from rrl.transforms import ControlNoise, FiniteAction, StepLimit
from rrl.transforms.base import SlotTransform
from situation_envs import Machine
from toy_envs import PointMass


class ByNumPy(Controller):
    """Leaves torch."""

    def act(self, tensordict):
        position, goal = (self.read(tensordict, key).numpy() for key in KEYS)
        return torch.from_numpy(2.0 * (goal - position))


class Decides(Controller):
    """Branches on a number."""

    def act(self, tensordict):
        error = self.read(tensordict, "goal") - self.read(tensordict, "end_effector_position")
        return 2.0 * error if error.norm() > 0.1 else error


class Counts(Controller):
    """Keeps a memory that it does not declare."""

    steps = 0

    def act(self, tensordict):
        self.steps += 1
        return 0.01 * self.steps * self.read(tensordict, "goal")


@pytest.mark.parametrize(
    "controller",
    [
        ByNumPy,
        pytest.param(Decides, marks=pytest.mark.slow),
        pytest.param(Counts, marks=pytest.mark.slow),
    ],
)
def test_a_controller_that_cannot_be_recorded_stays_outside(controller, tmp_path):
    factory = point(controller=partial(controller, KEYS), residual_scale=0.5)
    policy = random_policy(factory)
    content = export_policy(factory, policy, tmp_path / "export")
    assert content["controller"]["why_outside"]
    exported = Policy(tmp_path / "export")
    assert [e.name for e in exported.contract.entries] == [*KEYS, "base_action"]
    episode = trainers_episode(factory, policy, exported, seed=1)
    np.testing.assert_allclose(episode.shadow, episode.commands, rtol=0, atol=1e-6)


ENTRIES = {
    "position": Unbounded((2,)),
    "one-hot": OneHot(3),
    "one-hot numbers": OneHot(3, dtype=torch.int64),
    "several": MultiOneHot([3, 2]),
    "category": Categorical(3, (1,)),
    "flags": Binary(2, dtype=torch.int8),
    "steps": Bounded(0, 5, (3,), dtype=torch.int64),
    "picture": Bounded(0, 255, (2, 2), dtype=torch.uint8),
    ("nested", "one-hot"): OneHot(2),
}


@pytest.mark.parametrize("inputs", [["position"], list(ENTRIES)], ids=["unread", "read"])
def test_every_kind_of_entry_is_rehearsed(inputs, tmp_path):
    machine, read = partial(Machine, ENTRIES), dict.fromkeys(inputs, Input())
    factory = point(base=machine, controller=ZeroController, inputs=read, batching="serial")
    content = export_policy(factory, random_policy(factory), tmp_path / "export")
    assert [entry["name"] for entry in content["entries"]] == [
        name if isinstance(name, str) else ".".join(name) for name in inputs
    ]


class FromTheStart(StatefulController):
    """Remembers where the episode has begun: a state that depends on the first observation."""

    def initial_state(self, tensordict):
        start = self.read(tensordict, "end_effector_position")
        return {"start": start, "nested": {"steps": torch.zeros_like(start[..., :1])}}

    def act(self, tensordict):
        state = self.state_for(tensordict)
        steps = state["nested"]["steps"] + 1
        self.state = {"start": state["start"], "nested": {"steps": steps}}
        return state["start"] - 0.1 * steps * self.read(tensordict, "goal")


class Filtered(SlotTransform):
    """Prepares an entry: a moving average, which a robot needs as well."""

    def __init__(self):
        super().__init__(in_keys=["goal"], out_keys=["goal"])

    def _first(self, td, mask):
        return {"mean": td["goal"].clone()}

    def _advance(self, td, next_td, mask):
        return {"mean": 0.9 * self.recall("mean") + 0.1 * next_td["goal"]}


def test_memory_of_any_part_is_handed_from_step_to_step(tmp_path):
    factory = point(
        controller=partial(FromTheStart, KEYS),
        sensing=[Filtered],
        inputs=[*KEYS, "base_action", "previous_action"],
        action_history=3,
    )
    policy = random_policy(factory)
    content = export_policy(factory, policy, tmp_path / "export")
    assert content["left_out"] == {"disturbances": [], "sensing": []}
    exported = Policy(tmp_path / "export")
    names = {entry.name for entry in exported.contract.state}
    assert {"FromTheStart.start", "FromTheStart.nested.steps", "Filtered.mean"} <= names
    assert {"ActionHistory.history", "ActionHistory.given", "starts"} <= names
    for seed in range(2):
        episode = trainers_episode(factory, policy, exported, seed)
        np.testing.assert_allclose(episode.shadow, episode.commands, rtol=0, atol=1e-6)


def test_a_chain_without_memory_has_no_state(tmp_path):
    factory = point(safety=[])  # the guard against NaN remembers the last command
    content = export_policy(factory, random_policy(factory), tmp_path / "export")
    assert content["state"] == []
    assert content["ends_episode"] is None


def test_flags_that_an_environment_writes_as_numbers_are_no_obstacle(tmp_path):
    class Numbers(PointMass):
        def __init__(self, *args):
            super().__init__(*args)
            self.observation_spec["success"] = Unbounded((*self.batch_size, 1))

        def _observe(self):
            out = super()._observe()
            return out | {"success": out["success"].float()}

    factory = point(base=lambda num_envs=1: Numbers([num_envs]))
    content = export_policy(factory, random_policy(factory), tmp_path / "export")
    assert [e["name"] for e in content["entries"]] == KEYS


def test_what_is_recorded_of_the_executed_action_survives_without_its_noise(tmp_path):
    factory = point(disturbances=[partial(ControlNoise, mu=0.3)], inputs=[*KEYS, "executed_action"])
    content = export_policy(factory, random_policy(factory), tmp_path / "export")
    assert [e["name"] for e in content["entries"]] == KEYS
    assert [e["name"] for e in content["state"]] == ["last.action", "starts"]
    assert content["left_out"]["disturbances"] == [
        {"class": "rrl.transforms.control_noise.ControlNoise", "mu": 0.3}
    ]


def test_the_controller_alone_can_be_exported(tmp_path):
    env = point().make(1)
    export_policy(point(), zero_residual(env), tmp_path / "export")
    exported = Policy(tmp_path / "export")
    command = exported.act({"end_effector_position": [0.1, 0.2], "goal": [0.3, -0.1]})
    np.testing.assert_array_equal(command, exported.reports["base_action"])


class PD(Controller):
    """Torque from the angle, by a function that onnxruntime computes otherwise for NaN."""

    def act(self, tensordict):
        cos, sin, velocity = self.read(tensordict, "observation").split(1, dim=-1)
        return (-8.0 * torch.atan2(sin, cos) - 2.0 * velocity).clamp(-2.0, 2.0)


def test_nan_that_the_graph_would_not_see_is_refused(tmp_path):
    factory = EnvironmentFactory(
        base=partial(GymEnv, "Pendulum-v1"),
        controller=partial(PD, ["observation"]),
        inputs=["base_action"],
        safety=[FiniteAction],
        batching="serial",
    )
    export_policy(factory, random_policy(factory), tmp_path / "export")
    assert not read_contract(tmp_path / "export").entries[0].guarded
    with pytest.raises(ValueError, match="observation: expected finite numbers"):
        Policy(tmp_path / "export").act({"observation": [np.nan, 0.0, 0.0]})


def mixed(parts, scale):
    """A function that takes other factories."""


@pytest.mark.parametrize(
    ("make", "more"),
    [
        (partial(StepLimit, 0.1), {"arguments": [0.1]}),
        (partial(StepLimit, change=0.1), {"change": 0.1}),
        (
            partial(mixed, [partial(StepLimit, 0.1), StepLimit], scale=np.array([0.5, 1.0])),
            {
                "arguments": [
                    [{**named(StepLimit), "arguments": [0.1]}, named(StepLimit)["class"]]
                ],
                "scale": [0.5, 1.0],
            },
        ),
    ],
)
def test_a_contract_has_every_number_of_a_part(make, more):
    assert named(make) == {"class": f"{make.func.__module__}.{make.func.__qualname__}", **more}


@pytest.mark.slow
def test_an_earlier_export_is_replaced_and_nothing_else(tmp_path):
    folder = tmp_path / "export"
    export_policy(point(), random_policy(point()), folder, {"trained": {"seed": 1}})
    content = export_policy(point(), random_policy(point()), str(folder), {"trained": {"seed": 2}})
    assert read_contract(folder).content == content
    assert content["trained"] == {"seed": 2}
    assert list(tmp_path.iterdir()) == [folder]
    (tmp_path / "mine").mkdir()
    with pytest.raises(FileExistsError, match="mine: expected no folder or an earlier export"):
        export_policy(point(), random_policy(point()), tmp_path / "mine")
