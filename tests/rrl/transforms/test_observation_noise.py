"""Sensor noise: size, sign, specs, and what must be refused."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase, SerialEnv, TransformedEnv
from torchrl.envs.transforms import Compose

from rrl.slot_random import seed_env
from rrl.transforms import ObservationNoise
from toy_envs import PointMass
from transform_cases import POSITION, drive, random_actions


def errors(noise: ObservationNoise, steps: int, *batch: int) -> torch.Tensor:
    """Return what is seen minus what is, [T + 1, *batch, 2]."""
    actions = random_actions(steps, *batch, 2)
    truth = drive(PointMass(batch), actions)
    seen = drive(TransformedEnv(PointMass(batch), noise), actions)
    truth = [truth[0]] + [record["next"] for record in truth[1:]]
    seen = [seen[0]] + [record["next"] for record in seen[1:]]
    pairs = zip(truth, seen, strict=True)
    return torch.stack([b[POSITION] - a[POSITION] for a, b in pairs])


def test_sign_and_size_of_the_bias() -> None:
    out = errors(ObservationNoise([POSITION], bias=[0.1, -0.2]), 5, 3)
    assert torch.allclose(out, torch.tensor([0.1, -0.2]).expand(6, 3, 2), atol=1e-6)


def test_nothing_to_add_changes_nothing() -> None:
    assert torch.equal(errors(ObservationNoise([POSITION]), 5, 3), torch.zeros(6, 3, 2))


def test_mean_and_deviation_from_the_reset_on() -> None:
    out = errors(ObservationNoise([POSITION], sigma=[0.05, 0.2], bias=0.1, seed=0), 300, 10)
    assert torch.allclose(out.mean((0, 1)), torch.full((2,), 0.1), atol=0.02)
    assert torch.allclose(out.std((0, 1)), torch.tensor([0.05, 0.2]), rtol=0.05)
    assert (out[0] != 0.1).all()


def test_reward_and_success_see_the_truth() -> None:
    actions = random_actions(5, 2)
    truth = drive(PointMass(), actions)
    seen = drive(TransformedEnv(PointMass(), ObservationNoise([POSITION], 0.5, seed=0)), actions)
    for a, b in zip(truth[1:], seen[1:], strict=True):
        assert torch.equal(a["next", "reward"], b["next", "reward"])
        assert torch.equal(a["next", "success"], b["next", "success"])


def test_bounds_of_a_noisy_observation_are_gone() -> None:
    env = TransformedEnv(PointMass(), ObservationNoise(["goal"], sigma=10.0, seed=0))
    assert not hasattr(env.observation_spec["goal"], "low")
    assert env.observation_spec.is_in(env.reset().select(*env.observation_spec.keys()))


def test_out_keys_leave_the_original() -> None:
    noise = ObservationNoise([POSITION], 0.1, seed=0, out_keys=["seen"])
    start = TransformedEnv(PointMass(), noise).reset()
    assert torch.equal(start[POSITION], PointMass().reset()[POSITION])
    assert not torch.equal(start["seen"], start[POSITION])


def test_two_sensors_of_the_same_quantity_err_independently() -> None:
    cameras = [ObservationNoise([POSITION], 1.0, seed=0, out_keys=[name]) for name in ("a", "b")]
    start = TransformedEnv(PointMass(), Compose(*cameras)).reset()
    assert not torch.equal(start["a"], start["b"])


@pytest.mark.parametrize("keys", [POSITION, (POSITION,)], ids=str)
def test_the_numbers_do_not_depend_on_how_a_key_is_written(keys) -> None:
    def seen(keys):
        return TransformedEnv(PointMass(), ObservationNoise(keys, 0.1, seed=0)).reset()[POSITION]

    assert torch.equal(seen(keys), seen([POSITION]))


def test_samples_of_any_number_are_drawn_anew() -> None:
    noise = ObservationNoise(["x"], 1.0, seed=0)
    one, _, other = (noise(TensorDict({"x": torch.zeros(n, 2)}, [n]))["x"] for n in (4, 2, 4))
    assert not torch.isclose(one, other).any()


@pytest.mark.parametrize("values", [{"sigma": -1.0}, {"sigma": float("nan")}, {"bias": [[1.0]]}])
def test_bad_numbers(values) -> None:
    with pytest.raises(ValueError, match=r"(sigma|bias): expected"):
        ObservationNoise([POSITION], **values)


@pytest.mark.parametrize("keys", [([], None), (["a"], ["b", "c"])])
def test_bad_keys(keys) -> None:
    with pytest.raises(ValueError, match="at least one in key"):
        ObservationNoise(keys[0], out_keys=keys[1])


def test_wrong_length() -> None:
    env = TransformedEnv(PointMass(), ObservationNoise([POSITION], sigma=[0.1, 0.1, 0.1]))
    with pytest.raises(ValueError, match="sigma: expected one number or 2"):
        env.reset()


def test_unknown_observation() -> None:
    env = TransformedEnv(PointMass(), ObservationNoise(["blocks"]))
    with pytest.raises(KeyError, match=r"'blocks'.*goal"):
        env.reset()


def test_not_a_number_to_disturb() -> None:
    env = TransformedEnv(PointMass(), ObservationNoise(["success"]))
    with pytest.raises(TypeError, match="floating point"):
        env.reset()


def noise(sigma: float = 1.0) -> ObservationNoise:
    return ObservationNoise([POSITION], sigma=sigma)


def seeded(env: EnvBase) -> torch.Tensor:
    """What is seen in 1 000 slots at a reset after a seed, [1000, 2]."""
    seed_env(env, 3)
    return env.reset()[POSITION].reshape(-1, 2)


def serial(*inside: ObservationNoise) -> SerialEnv:
    return SerialEnv(
        2, lambda: TransformedEnv(PointMass([500]), Compose(*(n.clone() for n in inside)))
    )


def test_two_noises_of_one_sensor_are_unrelated() -> None:
    truth = seeded(PointMass([1000]))
    first = seeded(TransformedEnv(PointMass([1000]), noise())) - truth
    both = {
        "beside": TransformedEnv(PointMass([1000]), Compose(noise(), noise())),
        "inside and around": TransformedEnv(serial(noise()), noise()),
        "around all": TransformedEnv(serial(), Compose(noise(), noise())),
    }
    second = {name: seeded(env) - truth - first for name, env in both.items()}
    for other in second.values():  # the first one draws what it draws alone
        torch.testing.assert_close(other, second["beside"], atol=1e-5, rtol=0.0)
    assert second["beside"].std() == pytest.approx(1.0, abs=0.05)
    assert (first * second["beside"]).mean().abs() < 0.1
    again = TransformedEnv(PointMass([1000]), Compose(noise(), noise()))
    seed_env(again, 3)
    other = TransformedEnv(PointMass([1000], seed=3), Compose(noise(), noise()))
    other.load_state_dict(again.state_dict())
    torch.testing.assert_close(other.reset()[POSITION], truth + first + second["beside"])
