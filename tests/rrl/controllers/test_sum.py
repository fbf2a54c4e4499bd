"""Composition: sum, weights, clipping, memory of the members."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from rrl.controllers import (
    FunctionController,
    PIDController,
    ProportionalController,
    ReplayController,
    SumController,
    ZeroController,
)


def data(batch: int = 2) -> TensorDict:
    position = torch.zeros(batch, 2)
    goal = torch.tensor([[0.4, -0.2]]).expand(batch, 2)
    return TensorDict({"end_effector_position": position, "goal": goal}, batch_size=[batch])


def constant(*action: float) -> ReplayController:
    return ReplayController([list(action)])


def test_sum() -> None:
    controller = SumController([ProportionalController(), constant(0.1, 0.1), ZeroController(2)])
    assert torch.allclose(controller(data())["base_action"], torch.tensor([0.5, -0.1]).expand(2, 2))
    assert controller.in_keys == ["end_effector_position", "goal"]


def test_weights_and_clip() -> None:
    controller = SumController(
        [constant(1.0, 1.0), constant(0.5, -0.5)], weights=[0.5, [1.0, 2.0]], clip=[0.8, 0.3]
    )
    assert torch.allclose(controller.act(data())[0], torch.tensor([0.8, -0.3]))


def test_one_controller_scaled() -> None:
    controller = SumController([constant(1.0, -2.0)], weights=[-0.5])
    assert torch.allclose(controller.act(data())[0], torch.tensor([-0.5, 1.0]))


@pytest.mark.parametrize("settings", [{"weights": [0.5]}, {"clip": 0.5}])
def test_whole_numbers_are_weighted_and_clipped_as_others(settings) -> None:
    def act(*said):
        return SumController([FunctionController(lambda *_: said)], **settings).act(seen)[0]

    seen = TensorDict({"observation": torch.zeros(2, 1)}, [2])
    assert act(1, 0, -1).tolist() == act(1.0, 0.0, -1.0).tolist() == [0.5, 0.0, -0.5]


def test_sums_nest_and_members_are_reset_by_mask() -> None:
    replay = ReplayController([[1.0, 1.0], [2.0, 2.0]])
    controller = SumController([SumController([replay]), PIDController(integral_gain=1.0)])
    first = controller.act(data())
    controller.act(data())
    controller.reset(torch.tensor([True, False]))
    again = controller.act(data())
    assert torch.equal(again[0], first[0])
    assert not torch.equal(again[1], first[1])


def test_state_dict_keeps_the_memory_of_the_members() -> None:
    def make() -> SumController:
        return SumController([ReplayController([[1.0, 1.0], [2.0, 2.0]]), PIDController()])

    controller, other = make(), make()
    controller.act(data())
    other.load_state_dict(controller.state_dict())
    assert torch.equal(controller.act(data()), other.act(data()))


def test_bad_members() -> None:
    with pytest.raises(ValueError, match="at least one controller"):
        SumController([])
    with pytest.raises(TypeError, match=r"got \['Linear'\]"):
        SumController([nn.Linear(2, 2)])
    with pytest.raises(ValueError, match="weights: expected 1"):
        SumController([ZeroController(2)], weights=[1.0, 1.0])
    with pytest.raises(ValueError, match="clip: expected positive"):
        SumController([ZeroController(2)], clip=0.0)
    with pytest.raises(ValueError, match="weights: expected finite"):
        SumController([ZeroController(2)], weights=[float("inf")])


@pytest.mark.parametrize(
    ("members", "settings", "message"),
    [
        ([constant(1.0, 1.0)], {"weights": [[1.0] * 3]}, "weights: .* ReplayController's action"),
        ([constant(1.0)], {"weights": [[1.0, 2.0]]}, "weights: expected one number or 1"),
        ([constant(1.0, 1.0)], {"clip": [1.0] * 3}, "clip: expected one number or 2"),
        ([constant(1.0, 1.0), constant(1.0)], {}, r"one shape, got \(2, 2\) and.*\(2, 1\)"),
    ],
)
def test_what_does_not_fit_together_is_named(members, settings, message) -> None:
    with pytest.raises(ValueError, match=message):
        SumController(members, **settings).act(data())
