"""Sensor delay, rate and dropout, held to a tracker written as a plain list."""

from __future__ import annotations

import pytest
import torch
from torchrl.envs import TransformedEnv

from rrl.transforms import ObservationLatency
from toy_envs import PointMass
from transform_cases import POSITION, drive, random_actions, staggered


def positions(env, actions: torch.Tensor, key: str = POSITION) -> torch.Tensor:
    records = drive(env, actions)
    return torch.stack([records[0][key]] + [r["next", key] for r in records[1:]])


def delayed(steps: int, actions: torch.Tensor, **options) -> torch.Tensor:
    transform = ObservationLatency([POSITION], steps, **options)
    return positions(TransformedEnv(PointMass(actions.shape[1:-1]), transform), actions)


@pytest.mark.parametrize("batch", [(), (3,)])
@pytest.mark.parametrize("steps", [0, 1, 4])
def test_delay(steps: int, batch: tuple[int, ...]) -> None:
    actions = random_actions(12, *batch, 2)
    truth = positions(PointMass(batch), actions)
    seen = delayed(steps, actions)
    for time in range(13):
        assert torch.equal(seen[time], truth[max(time - steps, 0)])


@pytest.mark.parametrize("steps", [0, 2])
@pytest.mark.parametrize("interval", [2, 3])
def test_rate(steps: int, interval: int) -> None:
    actions = random_actions(12, 2)
    truth = positions(PointMass(), actions)
    seen = delayed(steps, actions, update_interval=interval)
    for time in range(13):
        measured = max(time - steps, 0) // interval * interval
        assert torch.equal(seen[time], truth[measured])


def test_dropout_holds_the_last_measurement() -> None:
    actions = random_actions(400, 4, 2)
    env = PointMass([4], episode_steps=1000)
    truth = positions(env, actions)
    transform = ObservationLatency([POSITION], 0, dropout=0.3, seed=0)
    seen = positions(TransformedEnv(PointMass([4], episode_steps=1000), transform), actions)
    assert torch.equal(seen[0], truth[0])
    lost = 0
    for time in range(1, 401):
        for slot in range(4):
            fresh = torch.equal(seen[time, slot], truth[time, slot])
            assert fresh or torch.equal(seen[time, slot], seen[time - 1, slot])
            lost += not fresh
    assert lost / 1600 == pytest.approx(0.3, abs=0.05)


def test_each_slot_has_its_own_time() -> None:
    """After a partial reset the slot sees its first observation, the others their delayed ones."""
    actions, resets = random_actions(20, 3, 2), staggered(20, 3)
    truth = drive(PointMass([3]), actions, resets)
    transform = ObservationLatency([POSITION], 2)
    seen = drive(TransformedEnv(PointMass([3]), transform), actions, resets)
    past: list[list[torch.Tensor]] = [[] for _ in range(3)]
    step = -1
    for real, late in zip(truth, seen, strict=True):
        stepped = "next" in real
        step += stepped
        for slot in range(3):
            if stepped or step < 0:
                now, shown = (real["next"], late["next"]) if stepped else (real, late)
            elif resets[step, slot]:
                past[slot], now, shown = [], real, late
            else:
                continue
            past[slot].append(now[POSITION][slot])
            assert torch.equal(shown[POSITION][slot], past[slot][max(len(past[slot]) - 3, 0)])


def test_keys_of_one_tracker_are_lost_together() -> None:
    keys = [POSITION, "goal"]
    transform = ObservationLatency(keys, 0, dropout=0.5, seed=0, out_keys=["a", "b"])
    env = TransformedEnv(PointMass(episode_steps=1000), transform)
    a, b = (positions(env, random_actions(30, 2), key) for key in ("a", "b"))
    assert a.shape == b.shape


def test_changing_what_was_delivered_does_not_change_the_queue() -> None:
    actions = random_actions(6, 2)
    expected = delayed(0, actions, update_interval=3)
    env = TransformedEnv(PointMass(), ObservationLatency([POSITION], 0, update_interval=3))
    tensordict = env.reset()
    for time, action in enumerate(actions):
        tensordict[POSITION].zero_()
        tensordict = env.step(tensordict.set("action", action))["next"].exclude("reward")
        assert torch.equal(tensordict[POSITION], expected[time + 1])


def test_works_on_flags_too() -> None:
    env = TransformedEnv(PointMass(), ObservationLatency(["success"], 2))
    assert env.rollout(5)["next", "success"].dtype == torch.bool


@pytest.mark.parametrize(
    "options",
    [{"steps": -1}, {"steps": 1.5}, {"update_interval": 0}, {"dropout": 1.0}, {"dropout": -0.1}],
)
def test_bad_numbers(options) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(options))}: expected"):
        ObservationLatency([POSITION], **options)


def test_no_keys() -> None:
    with pytest.raises(ValueError, match="at least one in key"):
        ObservationLatency([])


def test_unknown_observation() -> None:
    env = TransformedEnv(PointMass(), ObservationLatency(["blocks"]))
    with pytest.raises(KeyError, match=r"'blocks'.*goal"):
        env.reset()
