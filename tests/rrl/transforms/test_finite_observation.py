"""Observations and rewards that are not finite end the episode and are never seen."""

import pytest
import torch
from torchrl.envs import SerialEnv, TransformedEnv
from torchrl.envs.transforms import Compose, RenameTransform

from rrl.controllers import ProportionalController
from rrl.transforms import FiniteAction, FiniteObservation, ResidualAction
from toy_envs import EPISODE_STEPS, PointMass, ResetsItself
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


@pytest.mark.parametrize("name", ["gain", ("agents", "reward")])
def test_a_reward_may_have_any_name(name):
    chain = RenameTransform(["reward"], [name]), FiniteObservation(["goal"])
    env = TransformedEnv(Sensor([2], broken="reward"), Compose(*chain))
    last = drive(env, random_actions(3, 2, 2))[3]["next"]
    assert last[name][0] == 0
    assert last["done"].flatten().tolist() == [True, False]


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


class BlindAtReset(PointMass):
    """One slot's goal is not finite in the observation of a reset."""

    blind, bad, commands = True, torch.nan, ()

    def _reset(self, tensordict=None):
        out = super()._reset(tensordict)
        if self.blind:
            goal = out["goal"].clone()
            goal[0, ..., 0] = self.bad
            out["goal"] = goal
        return out

    def _step(self, tensordict):
        self.commands = (*self.commands, tensordict["action"])
        return super()._step(tensordict)


@pytest.mark.parametrize("bad", [torch.nan, torch.inf])
def test_zeros_stand_at_the_first_reset_and_its_step_ends_the_episode(bad):
    env = TransformedEnv(BlindAtReset([2]), FiniteObservation([POSITION, "goal"]))
    env.base_env.bad = bad
    start, first = drive(env, random_actions(1, 2, 2))
    assert start["goal"][0].tolist() == [0.0, 0.0]
    assert start[FLAG].flatten().tolist() == [True, False]
    for flag in (FLAG, "truncated", "done"):
        assert first["next"][flag].flatten().tolist() == [True, False]
    assert first["next", "goal"].isfinite().all()


def test_what_the_slot_showed_last_stands_at_a_reset():
    env = TransformedEnv(BlindAtReset([2]), FiniteObservation([POSITION, "goal"]))
    env.base_env.blind = False
    td = env.rollout(3)[:, -1]["next"]
    env.base_env.blind = True
    mask, again = torch.tensor([[True], [False]]), td.clone()
    for reset in (mask, torch.ones(2, 1, dtype=torch.bool), ~mask):
        again = env.reset(again.set("_reset", reset))
        assert torch.equal(again["goal"][0], td["goal"][0])
        assert again[FLAG].flatten().tolist()[0]
    env.base_env.blind = False
    td = env.step(env.rand_action(again))["next"]
    assert td["done"].flatten().tolist() == [True, False]
    td = env.step(env.rand_action(env.reset(td.set("_reset", td["done"]))))["next"]
    assert not td["done"].any()
    assert not td[FLAG].any()


def test_no_command_of_a_controller_that_was_blind_is_executed():
    env = TransformedEnv(BlindAtReset([2]))
    for transform in (
        FiniteAction("zero"),
        ResidualAction(ProportionalController(POSITION, "goal"), scale=0.5),
        FiniteObservation(["goal", "base_action"]),
    ):
        env.append_transform(transform)
    seen = drive(env, random_actions(1, 2, 2))
    (command,) = env.base_env.commands
    assert command[0].tolist() == [0.0, 0.0]
    assert (command[1] != 0).any()
    for record in seen:
        assert all(v.isfinite().all() for v in record.values(True, True) if v.is_floating_point())


def test_a_sensor_that_is_gone_at_resets_is_not_borne_for_ever():
    env = TransformedEnv(BlindAtReset([1]), FiniteObservation(["goal"], patience=2))
    for _ in range(2):
        drive(env, random_actions(1, 1, 2))
    with pytest.raises(FloatingPointError, match=r"goal: expected finite numbers, .* in 3 steps"):
        env.reset()


class BlindAndResetsItself(ResetsItself, BlindAtReset):
    pass


def test_an_environment_that_resets_itself_goes_on():
    env = TransformedEnv(BlindAndResetsItself([2]), FiniteObservation([POSITION, "goal"]))
    env.base_env.blind = False
    td = env.reset()
    env.base_env.blind = True
    for step in range(1, 2 * EPISODE_STEPS + 3):
        before = td["goal"]
        out, td = env.step_and_maybe_reset(env.rand_action(td))
        assert td["goal"].isfinite().all()
        assert out["next", "done"].all() == (step % EPISODE_STEPS == 0)
        if out["next", "done"].any():
            assert torch.equal(td["goal"][0], before[0])


class EndsWithoutReward(ResetsItself):
    """Gives no reward for an episode's last step, as physics that diverges does, in one slot."""

    def _step(self, tensordict):
        out = super()._step(tensordict)
        lost = out["done"] & (torch.arange(2) == 1).unsqueeze(-1)
        return out.set("reward", torch.where(lost, torch.nan, out["reward"]))


def test_the_last_reward_counts_where_the_environment_resets_itself():
    finite = FiniteObservation([POSITION, "goal"], patience=2)
    env = TransformedEnv(EndsWithoutReward([2]), finite)
    td = env.reset()
    for _ in range(2 * EPISODE_STEPS):
        out, td = env.step_and_maybe_reset(env.rand_action(td))
        ends, reward = bool(out["next", "done"].all()), out["next", "reward"].flatten()
        assert reward.isfinite().all() and (reward[1] == 0) == ends and reward[0] != 0
        assert td["safety", "observation"].flatten().tolist() == [False, ends]  # out hides it
    with pytest.raises(FloatingPointError, match=r"reward: expected finite numbers, .* in 3 steps"):
        env.rollout(EPISODE_STEPS, auto_reset=False, tensordict=td, break_when_any_done=False)


def test_what_was_borne_is_not_forgotten_with_a_state():
    env = TransformedEnv(BlindAtReset([1]), FiniteObservation(["goal"], patience=1))
    env.reset()
    again = TransformedEnv(BlindAtReset([1]), FiniteObservation(["goal"], patience=1))
    again.load_state_dict(env.state_dict())
    with pytest.raises(FloatingPointError, match="in 2 steps"):
        again.reset()
