"""The policy's last actions among the observations."""

import pytest
import torch
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import Compose

from rrl.transforms import ActionHistory, ControlNoise, ResidualAction
from toy_envs import PointMass, ResetsItself
from transform_cases import drive, proportional, random_actions, staggered

KEY = "previous_action"


def make(*transforms, batch=(2,)):
    return TransformedEnv(PointMass(batch, seed=0), Compose(*transforms))


def test_it_holds_what_the_policy_said_and_not_what_was_executed():
    env = make(
        ControlNoise(sigma=0.5, seed=0), ResidualAction(proportional(), scale=0.5), ActionHistory()
    )
    actions = random_actions(10, 2, 2)
    records = drive(env, actions)
    assert not records[0][KEY].any()
    for action, record in zip(actions, records[1:], strict=True):
        assert torch.equal(record["next", KEY], action)


def test_oldest_first_and_zeros_before_the_first_step():
    actions = random_actions(3, 2, 2)
    records = drive(make(ActionHistory(2)), actions)
    assert torch.equal(records[1]["next", KEY], torch.cat([torch.zeros(2, 2), actions[0]], -1))
    assert torch.equal(records[3]["next", KEY], torch.cat([actions[1], actions[2]], -1))


def test_an_episode_begins_with_zeros_in_its_own_slot_only():
    resets = staggered(6, 2)
    actions = random_actions(6, 2, 2)
    records, index = drive(make(ActionHistory()), actions, resets), 1
    for action, mask in zip(actions, resets, strict=True):
        assert torch.equal(records[index]["next", KEY], action)
        index += 1
        if mask.any():
            assert torch.equal(records[index][KEY], torch.where(mask, 0.0, action))
            index += 1


def test_an_environment_that_resets_itself_forgets_with_it():
    env = TransformedEnv(ResetsItself((1,), seed=0, episode_steps=3), ActionHistory())
    rollout = env.rollout(7, break_when_any_done=False)
    starts = (rollout[KEY] == 0).all(-1).squeeze(0)
    assert starts.nonzero().flatten().tolist() == [0, 3, 6]


def test_in_front_of_the_superposition_it_holds_the_sum():
    env = make(ActionHistory(), ResidualAction(proportional(), scale=0.5))
    first, second = drive(env, torch.zeros(1, 2, 2))
    assert torch.equal(second["next", KEY], first["base_action"])


@pytest.mark.parametrize("steps", [0, -1, 1.5, "2"])
def test_bad_numbers_of_steps_are_named(steps):
    with pytest.raises(ValueError, match="steps: expected a whole number of at least 1"):
        ActionHistory(steps)


def test_a_name_that_is_taken_is_named():
    with pytest.raises(ValueError, match=r"out_key: expected a name .* got 'goal'"):
        make(ActionHistory(out_key="goal")).observation_spec  # noqa: B018 - computing it is the test
