"""PID control held to its law written out, and to what it is for."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from rrl.controllers import PIDController, ProportionalController
from rrl.transforms import ResidualAction
from toy_envs import PointMass


def state(error: list[list[float]]) -> TensorDict:
    goal = torch.tensor(error)
    data = {"end_effector_position": torch.zeros_like(goal), "goal": goal}
    return TensorDict(data, batch_size=[len(error)])


def test_law() -> None:
    controller = PIDController(
        gain=2.0, integral_gain=3.0, derivative_gain=0.1, time_step=0.5, unit=10.0, clip=None
    )
    errors = [0.4, 0.1, -0.2]
    total = last = 0.0
    for step, error in enumerate(errors):
        total += error
        change = error - last if step else 0.0
        expected = (2.0 * error + 3.0 * total * 0.5 + 0.1 * change / 0.5) / 10.0
        action = controller.act(state([[error]]))
        assert torch.allclose(action, torch.tensor([[expected]]))
        last = error


def test_without_integral_and_derivative_it_is_the_proportional_controller() -> None:
    pid, proportional = (
        PIDController(gain=0.7, unit=0.1),
        ProportionalController(gain=0.7, unit=0.1),
    )
    for error in ([[0.1, -0.3]], [[0.02, 0.01]]):
        assert torch.equal(pid.act(state(error)), proportional.act(state(error)))


def test_integral_does_not_wind_up_while_clipped() -> None:
    controller = PIDController(gain=1.0, integral_gain=1.0, time_step=1.0, clip=0.5)
    for _ in range(100):
        controller.act(state([[1.0]]))
    assert controller.state is not None
    assert controller.state["error_sum"].abs().max() <= 1.0
    assert controller.act(state([[-1.0]])) == -0.5


def test_integral_removes_the_steady_error_of_a_drift() -> None:
    ends = []
    for controller in (
        PIDController(gain=0.5, integral_gain=4.0, unit=0.1),
        ProportionalController(gain=0.5, unit=0.1),
    ):
        env = TransformedEnv(PointMass([4], episode_steps=80), ResidualAction(controller))
        rollout = env.rollout(80, lambda td: td.set("action", torch.zeros(4, 2)))
        ends.append(rollout["next", "reward"][:, -1].abs().max())
    assert ends[0] < 0.02 < 0.1 < ends[1]


def test_reset_by_mask() -> None:
    controller, fresh = PIDController(integral_gain=1.0), PIDController(integral_gain=1.0)
    controller.act(state([[0.1], [0.2]]))
    controller.reset(torch.tensor([True, False]))
    out = controller.act(state([[0.3], [0.3]]))
    assert torch.equal(out[0], fresh.act(state([[0.3]]))[0])
    assert not torch.equal(out[1], out[0])


def test_only_some_slots_remember() -> None:
    controller = PIDController(integral_gain=1.0)
    controller.act(state([[0.1], [0.2]]))
    with controller.only(torch.tensor([True, False])):
        first = controller.act(state([[0.3], [0.3]]))
    again = controller.act(state([[0.3], [0.3]]))
    assert not torch.equal(again[0], first[0])
    assert torch.equal(again[1], first[1])


def test_state_dict_round_trip() -> None:
    controller, other = PIDController(integral_gain=1.0), PIDController(integral_gain=1.0)
    controller.act(state([[0.1], [0.2]]))
    other.load_state_dict(controller.state_dict())
    assert torch.equal(controller.act(state([[0.3], [0.1]])), other.act(state([[0.3], [0.1]])))


@pytest.mark.parametrize("name", ["gain", "integral_gain", "derivative_gain"])
def test_bad_gains(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected finite"):
        PIDController(**{name: float("nan")})


@pytest.mark.parametrize("name", ["time_step", "clip", "unit"])
def test_what_must_be_positive(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected positive"):
        PIDController(**{name: 0.0})


def test_lists_of_different_lengths_are_named() -> None:
    with pytest.raises(ValueError, match=r"time_step: expected one number or 2, .* got 3"):
        PIDController(integral_gain=[0.1] * 2, time_step=[0.1] * 3)
    with pytest.raises(ValueError, match=r"unit: expected one number or 2, .* got 3"):
        PIDController(gain=[0.1] * 2, unit=[0.1] * 3)


def test_missing_key_is_named() -> None:
    with pytest.raises(KeyError, match=r"'end_effector_position'.*other"):
        PIDController().act(TensorDict({"other": torch.zeros(2)}))
