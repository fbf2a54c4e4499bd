"""The disturbance: size, sign, order, record, and what must be refused."""

from __future__ import annotations

import pytest
import torch
from torchrl.data import Composite, Unbounded
from torchrl.envs import TransformedEnv, check_env_specs
from torchrl.envs.transforms import Compose

from rrl.controllers import ReplayController
from rrl.transforms import ControlNoise, ResidualAction, StepLimit
from toy_envs import PointMass
from transform_cases import drive, random_actions


def executed(noise: ControlNoise, actions: torch.Tensor, **env) -> torch.Tensor:
    env = TransformedEnv(PointMass(actions.shape[1:-1], **env), noise)
    records = drive(env, actions)
    return torch.stack([record["next", "executed_action"] for record in records[1:]])


def test_nothing_to_disturb_passes_bit_for_bit() -> None:
    actions = random_actions(20, 3, 2)
    assert torch.equal(executed(ControlNoise(0.0, 0.0, seed=0), actions), actions)


def test_sign_and_size_of_the_bias() -> None:
    out = executed(ControlNoise(mu=[0.2, -0.1]), torch.zeros(3, 2))
    assert torch.allclose(out, torch.tensor([0.2, -0.1]).expand(3, 2))
    out = executed(ControlNoise(mu=0.2), torch.zeros(3, 2), bound=3.0)
    assert torch.allclose(out, torch.full((3, 2), 0.6))


def test_bias_moves_the_point_that_way() -> None:
    still = drive(TransformedEnv(PointMass(drift=0.0), ControlNoise()), torch.zeros(1, 2))
    pushed = drive(TransformedEnv(PointMass(drift=0.0), ControlNoise(0.5)), torch.zeros(1, 2))
    moved = pushed[1]["next", "end_effector_position"] - still[1]["next", "end_effector_position"]
    assert torch.allclose(moved, torch.full((2,), 0.05))


def test_mean_and_deviation() -> None:
    out = executed(ControlNoise(mu=0.1, sigma=[0.05, 0.2], seed=0), torch.zeros(500, 8, 2))
    assert torch.allclose(out.mean((0, 1)), torch.full((2,), 0.1), atol=0.01)
    assert torch.allclose(out.std((0, 1)), torch.tensor([0.05, 0.2]), rtol=0.05)
    wide = executed(ControlNoise(mu=0.1, sigma=0.05, seed=0), torch.zeros(500, 8, 2), bound=3.0)
    assert wide.mean().item() == pytest.approx(0.3, abs=0.01)
    assert wide.std().item() == pytest.approx(0.15, rel=0.05)
    one_step_apart = (out[1:] * out[:-1]).mean((0, 1)) - 0.01
    assert one_step_apart.abs().max() < 0.005


def test_dimensions_and_slots_draw_different_numbers() -> None:
    out = executed(ControlNoise(sigma=0.1, seed=0), torch.zeros(50, 4, 2)).reshape(50, 8)
    correlation = torch.corrcoef(out.T) - torch.eye(8)
    assert correlation.abs().max() < 0.5


def test_clipped_at_the_bounds() -> None:
    out = executed(ControlNoise(mu=0.9, sigma=0.5, seed=0), torch.full((50, 2), 0.5))
    assert out.max() == 1.0
    assert out.min() >= -1.0


def test_sum_first_then_noise_then_clip() -> None:
    """Base 0.9 and residual 0.5 are clipped to 1, then the bias takes 0.3 from it."""
    chain = Compose(ControlNoise(mu=-0.3), ResidualAction(ReplayController([[0.9, 0.0]])))
    records = drive(TransformedEnv(PointMass(), chain), torch.tensor([[0.5, 0.25]]))
    assert torch.allclose(records[1]["next", "executed_action"], torch.tensor([0.7, -0.05]))
    assert torch.allclose(records[1]["action"], torch.tensor([0.5, 0.25]))


def test_a_record_of_any_name_is_what_a_safety_limit_has_let_pass() -> None:
    chain = Compose(StepLimit(size=0.2), ControlNoise(executed_action_key="sent"))
    record = drive(TransformedEnv(PointMass(), chain), torch.ones(1, 2))[1]
    assert torch.equal(record["next", "sent"], torch.full((2,), 0.2))


def test_record_is_zero_at_reset_by_mask() -> None:
    env = TransformedEnv(PointMass([2]), ControlNoise(sigma=0.1, seed=0))
    resets = torch.tensor([[[False], [True]]])
    start, step, reset = drive(env, random_actions(1, 2, 2), resets)
    assert torch.equal(start["executed_action"], torch.zeros(2, 2))
    assert torch.equal(reset["executed_action"][1], torch.zeros(2))
    assert torch.equal(reset["executed_action"][0], step["next", "executed_action"][0])


def test_same_seed_as_observation_noise_is_not_the_same_noise() -> None:
    from rrl.transforms import ObservationNoise

    control = executed(ControlNoise(sigma=0.1, seed=0), torch.zeros(20, 2))
    env = TransformedEnv(
        PointMass(drift=0.0), ObservationNoise(["end_effector_position"], 0.1, seed=0)
    )
    seen = torch.stack(
        [r["next", "end_effector_position"] for r in drive(env, torch.zeros(20, 2))[1:]]
    )
    assert not torch.allclose(control, seen - env.base_env._position, atol=1e-3)


def test_two_in_a_row_draw_different_numbers() -> None:
    two = [ControlNoise(sigma=0.1, seed=0, executed_action_key=name) for name in ("a", "b")]
    records = drive(TransformedEnv(PointMass((8,)), Compose(*two)), torch.zeros(100, 8, 2))
    sent = torch.stack([record["next", "a"] for record in records[1:]])
    assert sent.std().item() == pytest.approx(0.1 * 2**0.5, rel=0.05)


def test_nested_action() -> None:
    env = TransformedEnv(
        PointMass([2], action_key=("arm", "action")),
        ControlNoise(sigma=0.1, seed=0, action_key=("arm", "action")),
    )
    check_env_specs(env)
    assert ("arm", "executed_action") in env.reset().keys(True)


def test_action_without_bounds_is_not_clipped() -> None:
    base = PointMass()
    base.full_action_spec = Composite(action=Unbounded((2,)))
    env = TransformedEnv(base, ControlNoise(mu=0.5))
    check_env_specs(env)
    record = drive(env, torch.tensor([[3.0, -7.0]]))[1]
    assert torch.equal(record["next", "executed_action"], torch.tensor([3.5, -6.5]))


@pytest.mark.parametrize("sigma", [-0.1, [0.1, -0.1], float("nan"), float("inf"), [], [[0.1]]])
def test_bad_sigma(sigma) -> None:
    with pytest.raises(ValueError, match="sigma: expected"):
        ControlNoise(sigma=sigma)


@pytest.mark.parametrize("mu", [float("nan"), [[0.1]]])
def test_bad_mu(mu) -> None:
    with pytest.raises(ValueError, match="mu: expected"):
        ControlNoise(mu=mu)


@pytest.mark.parametrize("seed", [0.5, "1", True])
def test_bad_seed(seed) -> None:
    with pytest.raises(TypeError, match="seed: expected an integer or None"):
        ControlNoise(seed=seed)


def test_wrong_length() -> None:
    env = TransformedEnv(PointMass(), ControlNoise(mu=[0.1, 0.1, 0.1]))
    with pytest.raises(ValueError, match=r"mu: expected one number or 2, .* got 3"):
        drive(env, torch.zeros(1, 2))


def test_unknown_action() -> None:
    env = TransformedEnv(PointMass(), ControlNoise(action_key="torque"))
    with pytest.raises(KeyError, match=r"action_key: expected one of .*'action'.*, got 'torque'"):
        env.reset()


def test_record_key_that_is_taken() -> None:
    two = Compose(ControlNoise(), ControlNoise())
    with pytest.raises(ValueError, match="executed_action_key: expected a name"):
        TransformedEnv(PointMass(), two).reset()
