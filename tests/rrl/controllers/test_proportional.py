"""The paper's controller: law, clipping, units."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from rrl.controllers import PIDController, ProportionalController


def state(position: list[float], goal: list[float]) -> TensorDict:
    return TensorDict(
        {"end_effector_position": torch.tensor([position]), "goal": torch.tensor([goal])},
        batch_size=[1],
    )


def test_towards_the_goal_in_action_units() -> None:
    controller = ProportionalController(gain=0.5, unit=0.02)
    action = controller(state([0.1, 0.0], [0.12, -0.01]))["base_action"]
    assert torch.allclose(action, torch.tensor([[0.5, -0.25]]), atol=1e-5)


def test_gain_and_clip_for_each_dimension() -> None:
    controller = ProportionalController(gain=[1.0, 10.0], clip=[0.5, 2.0])
    action = controller.act(state([0.0, 0.0], [1.0, 0.1]))
    assert torch.allclose(action, torch.tensor([[0.5, 1.0]]))
    action = controller.act(state([0.0, 0.0], [-1.0, -1.0]))
    assert torch.allclose(action, torch.tensor([[-0.5, -2.0]]))


@pytest.mark.parametrize(
    "controller",
    [
        ProportionalController(gain=0.5, clip=None),
        ProportionalController(gain=2.0, clip=0.8),
        PIDController(gain=0.5, integral_gain=0.2, derivative_gain=0.01, clip=None),
    ],
)
@pytest.mark.parametrize("dtype", [torch.int64, torch.uint8])
def test_a_position_may_be_a_whole_number(controller, dtype) -> None:
    positions = torch.tensor([[[0, 7]], [[1, 5]], [[4, 1]]]), torch.tensor([[4, 0]])

    def actions(*values):
        controller.reset()
        tds = [TensorDict({"end_effector_position": p, "goal": values[1]}, [1]) for p in values[0]]
        return torch.stack([controller.act(td) for td in tds])

    whole = actions(*(value.to(dtype) for value in positions))
    assert torch.equal(whole, actions(*(value.float() for value in positions)))


def test_no_clipping() -> None:
    action = ProportionalController(clip=None).act(state([0.0, 0.0], [7.0, -8.0]))
    assert torch.equal(action, torch.tensor([[7.0, -8.0]]))


def test_reads_nothing_but_robot_and_goal() -> None:
    controller = ProportionalController(position_key=("robot", "tool"), goal_key="target")
    assert controller.in_keys == [("robot", "tool"), "target"]
    assert controller.out_keys == ["base_action"]


def test_missing_key_is_named() -> None:
    with pytest.raises(KeyError, match=r"ProportionalController: expected .* 'goal'.*wrench"):
        data = {"end_effector_position": torch.zeros(3), "wrench": torch.zeros(6)}
        ProportionalController()(TensorDict(data))


def test_shapes_that_do_not_fit() -> None:
    with pytest.raises(ValueError, match="'goal': expected the shape of 'end_effector_position'"):
        ProportionalController().act(state([0.0, 0.0], [0.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="gain: expected one number or 2"):
        ProportionalController(gain=[1.0, 1.0, 1.0]).act(state([0.0, 0.0], [0.0, 0.0]))
    with pytest.raises(ValueError, match="clip: expected one number or 2"):
        ProportionalController(clip=[1.0, 1.0, 1.0]).act(state([0.0, 0.0], [0.0, 0.0]))


@pytest.mark.parametrize(
    "options",
    [
        {"gain": float("nan")},
        {"gain": [[1.0]]},
        {"gain": []},
        {"clip": 0.0},
        {"clip": -1.0},
        {"unit": 0.0},
        {"unit": float("inf")},
    ],
)
def test_bad_parameters(options) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(options))}: expected"):
        ProportionalController(**options)
