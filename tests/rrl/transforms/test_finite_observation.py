"""Observations and rewards that are not finite end the episode and are never seen."""

import pytest
import torch
from torchrl.envs import SerialEnv, TransformedEnv

from rrl.transforms import FiniteObservation
from toy_envs import PointMass
from transform_cases import POSITION, drive, random_actions

FLAG = FiniteObservation.FLAG


class Sensor(PointMass):
    """One slot's goal, or its reward, is not finite in the third step of an episode."""

    def __init__(self, batch, bad=torch.nan, broken="goal"):
        super().__init__(batch)
        self.bad, self.broken, self.steps = bad, broken, 0

    def _reset(self, tensordict=None):
        self.steps = 0
        return super()._reset(tensordict)

    def _step(self, tensordict):
        out = super()._step(tensordict)
        self.steps += 1
        if self.steps == 3:
            value = out[self.broken].clone()
            value[0, ..., -1] = self.bad
            out[self.broken] = value
        return out


@pytest.mark.parametrize("bad", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("broken", ["goal", POSITION, "reward"])
def test_the_step_before_stands_and_the_episode_ends(bad, broken):
    env = TransformedEnv(Sensor([2], bad, broken), FiniteObservation([POSITION, "goal"]))
    seen = drive(env, random_actions(3, 2, 2))
    before, last = seen[2]["next"], seen[3]["next"]
    kept = torch.zeros(1) if broken == "reward" else before[broken][0]
    assert torch.equal(last[broken][0], kept)
    assert last[FLAG].flatten().tolist() == [True, False]
    assert last["truncated"].flatten().tolist() == [True, False]
    assert last["done"].flatten().tolist() == [True, False]
    assert not last["terminated"].any()
    assert not any(record["next"][FLAG].any() for record in seen[1:3])
    assert all(v.isfinite().all() for v in last.values(True, True) if v.is_floating_point())


def test_after_the_reset_it_goes_on():
    env = TransformedEnv(SerialEnv(2, lambda: Sensor([1])), FiniteObservation(["goal"]))
    resets = torch.zeros(4, 2, 1, 1, dtype=torch.bool)
    resets[2] = True
    seen = drive(env, random_actions(4, 2, 1, 2), resets)
    assert seen[3]["next"][FLAG].all()
    assert not seen[4][FLAG].any()
    assert not seen[5]["next"][FLAG].any()


def test_a_sensor_that_is_gone_is_not_borne_for_ever():
    env = TransformedEnv(Sensor([1]), FiniteObservation(["goal"], patience=2))
    resets = torch.ones(3, 1, 1, dtype=torch.bool)
    for _ in range(2):
        drive(env, random_actions(3, 1, 2), resets & (torch.arange(3) == 2).reshape(-1, 1, 1))
    with pytest.raises(FloatingPointError, match=r"goal: expected finite numbers, .* in 3 steps"):
        drive(env, random_actions(3, 1, 2))


def test_an_episode_that_ends_well_restores_patience():
    env = TransformedEnv(Sensor([1]), FiniteObservation(["goal"], patience=1))
    for _ in range(3):
        drive(env, random_actions(3, 1, 2))
        env.base_env.broken = "reward"
        env.base_env.bad = 0.0
        drive(env, random_actions(60, 1, 2))
        env.base_env.broken, env.base_env.bad = "goal", torch.nan
