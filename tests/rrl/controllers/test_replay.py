"""Replayed actions: order, end, resets by mask."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict

from rrl.controllers import ReplayController

ACTIONS = [[1.0], [2.0], [3.0]]


def play(controller: ReplayController, steps: int, batch: int = 1) -> list[list[float]]:
    empty = TensorDict({}, batch_size=[batch])
    return [controller.act(empty).flatten().tolist() for _ in range(steps)]


@pytest.mark.parametrize(("after_end", "last"), [("hold", 3.0), ("zero", 0.0)])
def test_in_order_and_after_the_end(after_end: str, last: float) -> None:
    played = play(ReplayController(ACTIONS, after_end), 6)
    assert played == [[1.0], [2.0], [3.0], [last], [last], [last]]


def test_each_slot_has_its_own_place() -> None:
    controller = ReplayController(ACTIONS)
    play(controller, 2, batch=2)
    controller.reset(torch.tensor([False, True]))
    assert play(controller, 2, batch=2) == [[3.0, 1.0], [3.0, 2.0]]
    controller.reset()
    assert play(controller, 1, batch=2) == [[1.0, 1.0]]


def test_without_a_batch() -> None:
    controller = ReplayController(torch.tensor(ACTIONS))
    assert controller.act(TensorDict()).tolist() == [1.0]
    assert controller.act(TensorDict()).tolist() == [2.0]


def test_the_sequence_is_a_copy() -> None:
    actions = torch.tensor(ACTIONS)
    controller = ReplayController(actions)
    actions.zero_()
    assert play(controller, 1) == [[1.0]]


def test_state_dict_keeps_the_place() -> None:
    controller, other = ReplayController(ACTIONS), ReplayController([[0.0], [0.0], [0.0]])
    play(controller, 1)
    other.load_state_dict(controller.state_dict())
    assert play(other, 1) == [[2.0]]


@pytest.mark.parametrize("actions", [[], [1.0], torch.zeros(3, 0)])
def test_bad_shape(actions) -> None:
    with pytest.raises(ValueError, match=r"shape \[T, n_act\]"):
        ReplayController(actions)


def test_bad_values() -> None:
    with pytest.raises(ValueError, match="actions: expected finite"):
        ReplayController([[float("nan")]])
    with pytest.raises(ValueError, match="after_end: expected 'hold' or 'zero'"):
        ReplayController(ACTIONS, after_end="loop")
