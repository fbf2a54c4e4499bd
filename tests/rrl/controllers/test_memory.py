"""Memory of controllers: every episode of every slot starts from ``initial_state``."""

from __future__ import annotations

import copy
import pickle
from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, EnvBase, ParallelEnv, SerialEnv, TransformedEnv

from rrl.controllers import Controller, StatefulController, SumController
from rrl.interventions import ScriptedOperator
from rrl.transforms import Intervention, ResidualAction
from toy_envs import PointMass, ResetsItself
from transform_cases import Plan


def transformed(env: EnvBase) -> TransformedEnv:
    return TransformedEnv(env, ResidualAction(SumController([Plan()]), scale=0.0))


def single(length: int) -> TransformedEnv:
    return transformed(PointMass(seed=length, episode_steps=length))


LENGTHS = (4, 7)
"""A plan has five actions, one for the reset and four for steps: of an episode of seven the last
plan is in use when it ends."""
KINDS = {
    "single": lambda: single(7),
    "batch": lambda: transformed(PointMass([3], episode_steps=7)),
    "serial outside": lambda: transformed(
        SerialEnv(2, [partial(PointMass, seed=n, episode_steps=n) for n in LENGTHS])
    ),
    "serial inside": lambda: SerialEnv(2, [partial(single, n) for n in LENGTHS]),
    "parallel inside": lambda: ParallelEnv(
        2, [partial(single, n) for n in LENGTHS], mp_start_method="spawn"
    ),
    "resets itself": lambda: transformed(ResetsItself([3], episode_steps=4)),
}


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=[pytest.mark.slow] * ("parallel" in k)) for k in KINDS]
)
def test_a_plan_is_that_of_its_episode(kind: str) -> None:
    """The plan is the goal of the episode; an old plan, or zeros, would be another action."""
    env = KINDS[kind]()
    try:
        tensordict = env.reset()
        for _ in range(20):
            assert torch.equal(tensordict["base_action"], tensordict["goal"])
            _, tensordict = env.step_and_maybe_reset(env.rand_action(tensordict))
    finally:
        env.close(raise_if_closed=False)


def test_one_slot_of_three_reset_twice_in_a_row() -> None:
    env = transformed(PointMass([3], blind_reset=True))
    tensordict = env.reset()
    before = tensordict["base_action"]
    for _ in range(2):
        mask = torch.tensor([[False], [True], [False]])
        tensordict = env.reset(tensordict.set("_reset", mask))
        assert torch.equal(tensordict["base_action"][1], tensordict["goal"][1])
        assert torch.equal(tensordict["base_action"][::2], before[::2])
    steps = env.transform.controller.controllers[0].state["episode_steps"]
    assert steps.tolist() == [1, 1, 1]
    tensordict = env.step(env.rand_action(tensordict))["next"]
    env.reset(tensordict.exclude("reward").set("_reset", mask))
    steps = env.transform.controller.controllers[0].state["episode_steps"]
    assert steps.tolist() == [2, 1, 2]


def driven_by(*controllers: Controller) -> list[EnvBase]:
    return [TransformedEnv(PointMass([2]), ResidualAction(c, scale=0.0)) for c in controllers]


def operated(controller: Controller, operator: Controller) -> EnvBase:
    intervention = Intervention(ScriptedOperator(operator, share=0.0), step_limit=1.0)
    return TransformedEnv(PointMass([2]), Compose(intervention, ResidualAction(controller)))


def test_two_environments_at_once_need_a_controller_each() -> None:
    plan = Plan()
    one, other = driven_by(plan, plan)
    tensordict = one.rollout(2)[..., -1]["next"].exclude("reward")
    other.rollout(2)
    with pytest.raises(
        RuntimeError, match=r"Plan: expected one environment or operator, .* second"
    ):
        one.step(one.rand_action(tensordict))
    one.rollout(2)  # one after the other they may share it
    other.rollout(2)


def test_operator_and_residual_need_a_controller_each() -> None:
    operated(Plan(), Plan()).rollout(2)
    plan = Plan()
    with pytest.raises(RuntimeError, match="make a controller for each"):
        operated(plan, plan).rollout(2)
    with pytest.raises(ValueError, match="expected each one with a memory once"):
        SumController([plan, SumController([plan])])


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_in_the_middle_of_an_episode(copied) -> None:
    env = operated(Plan(), Plan())
    tensordict = env.rollout(2)[..., -1]["next"].exclude("reward")
    tensordict["action"] = torch.ones(2, 2)
    twin = copied(env)
    steps = [one.step(tensordict.clone())["next", "base_action"] for one in (env, twin)]
    assert torch.equal(*steps)


class CountDown(StatefulController):
    """A memory of one number for all slots, counted down from three."""

    def initial_state(self, tensordict):
        return {"left": torch.tensor(3)}

    def act(self, tensordict):
        left = self.state_for(tensordict)["left"]
        self.state = {"left": left - 1}
        return left.unsqueeze(-1)


def test_a_number_becomes_one_for_each_slot() -> None:
    controller, data = CountDown([]), TensorDict(batch_size=[2])
    assert controller.act(data).tolist() == [[3], [3]]
    controller.reset(torch.tensor([True, False]))
    assert controller.act(data).tolist() == [[3], [2]]
    controller.reset(torch.tensor([False, True]))
    saved = controller.state_dict()  # holds the reset that is still to come
    other = CountDown([])
    other.load_state_dict(saved)
    assert other.act(data).tolist() == controller.act(data).tolist() == [[2], [3]]
    assert controller.act(TensorDict(batch_size=[3])).tolist() == [[3]] * 3


def test_first_call_by_mask_starts_the_others_too() -> None:
    controller, data = CountDown([]), TensorDict(batch_size=[2])
    with controller.only(torch.tensor([True, False])):
        controller.act(data)
    assert controller.act(data).tolist() == [[2], [3]]


class FromStart(StatefulController):
    """Remembers where it started, without a copy of its own."""

    def initial_state(self, tensordict):
        return {"start": tensordict["x"]}

    def act(self, tensordict):
        return self.state_for(tensordict)["start"]


def test_an_environment_that_changes_its_tensors_in_place_leaves_the_memory_alone() -> None:
    controller, data = FromStart(["x"]), TensorDict({"x": torch.zeros(2, 1)}, [2])
    controller.act(data)
    data["x"] += 1.0
    assert controller.act(data).tolist() == [[0.0], [0.0]]


class Forgets(StatefulController):
    """Does not say what an episode starts with."""

    def act(self, tensordict):
        return self.state_for(tensordict)["x"]


@pytest.mark.parametrize(("kind", "method"), [(Controller, "act"), (Forgets, "initial_state")])
def test_a_method_that_is_missing_is_named(kind, method) -> None:
    expected = rf"{kind.__name__}: expected a method {method}\(\), got none"
    with pytest.raises(NotImplementedError, match=expected):
        TransformedEnv(PointMass(), ResidualAction(kind([]))).reset()
