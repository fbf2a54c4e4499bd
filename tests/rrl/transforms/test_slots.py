"""Memory and random numbers slot by slot, for every transform: resets, seeds, clones, states."""

from __future__ import annotations

import copy
import io
import pickle

import pytest
import torch
from torchrl.envs import SerialEnv, TransformedEnv
from torchrl.envs.transforms import Compose, Transform

from rrl.slot_random import seed_env
from rrl.transforms import ObservationNoise
from toy_envs import PointMass, ResetsItself
from transform_cases import (
    CASES,
    POSITION,
    Factory,
    assert_same,
    drive,
    make_env,
    random_actions,
    staggered,
)

SLOTS = 3
STEPS = 25

each_case = pytest.mark.parametrize("name", CASES)


@each_case
def test_slot_of_a_batch_equals_a_batch_of_one(name: str) -> None:
    actions, resets = random_actions(STEPS, SLOTS, 2), staggered(STEPS, SLOTS)
    whole = drive(make_env(CASES[name], (SLOTS,), seed=5), actions, resets)
    for slot in range(SLOTS):
        one = slice(slot, slot + 1)
        # Resets elsewhere add records; those of the slot alone are compared.
        alone = drive(make_env(CASES[name], (1,), seed=5 + slot), actions[:, one], resets[:, one])
        mine = [record[one] for record in only_with_own_resets(whole, resets, slot)]
        assert_same(mine, alone)


def only_with_own_resets(records: list, resets: torch.Tensor, slot: int) -> list:
    kept, index = [records[0]], 1
    for mask in resets:
        kept.append(records[index])
        index += 1
        if mask.any():
            if mask[slot].any():
                kept.append(records[index])
            index += 1
    return kept


@each_case
def test_batch_of_none_equals_batch_of_one(name: str) -> None:
    actions = random_actions(STEPS, 2)
    scalar = drive(make_env(CASES[name], (), seed=4), actions)
    batched = drive(make_env(CASES[name], (1,), seed=4), actions.unsqueeze(1))
    assert_same(scalar, [record[0] for record in batched])


@each_case
def test_serial_inside_and_outside_equal_a_batch(name: str) -> None:
    actions, resets = random_actions(STEPS, SLOTS, 2), staggered(STEPS, SLOTS)
    factory = CASES[name]
    inside = SerialEnv(SLOTS, lambda: make_env(factory))
    outside = TransformedEnv(SerialEnv(SLOTS, PointMass), factory(0))
    batch = make_env(factory, (SLOTS,))
    for env in (inside, outside, batch):
        seed_env(env, 11)
    expected = drive(batch, actions, resets)
    assert_same(drive(outside, actions, resets), expected)
    assert_same(drive(inside, actions, resets), expected)


@each_case
@pytest.mark.parametrize("blind", [False, True])
def test_partial_reset_leaves_the_others_alone(name: str, blind: bool) -> None:
    """Nothing the environment says about slots that are not reset may matter."""
    actions = random_actions(6, SLOTS, 2)
    env = TransformedEnv(PointMass([SLOTS], blind_reset=blind), CASES[name](0))
    undisturbed = drive(make_env(CASES[name], (SLOTS,)), actions)
    resets = torch.zeros(6, SLOTS, 1, dtype=torch.bool)
    resets[2, 1] = True
    records = drive(env, actions, resets)
    at_reset = records.pop(4)
    for slot in (0, 2):
        for before, after in zip(undisturbed, records, strict=True):
            assert_same([before[slot]], [after[slot]])
        carried = records[3]["next"].select(*at_reset.keys(True, True), strict=False)[slot]
        assert_same([carried], [at_reset[slot].select(*carried.keys(True, True))])


@each_case
def test_seed_reproduces_and_tells_apart(name: str) -> None:
    actions = random_actions(STEPS, 2, 2)
    env = make_env(CASES[name], (2,), seed=0)
    recordings = []
    for seed in (1, 2, 1):
        seed_env(env, seed)
        recordings.append(drive(env, actions))
    assert_same(recordings[0], recordings[2])
    names = [
        key for key in (*env.transform.out_keys, "observation", POSITION) if isinstance(key, str)
    ]
    out = next(
        key for key in names if key in env.observation_spec
    )  # a limit's flag is often the same
    differs = [
        not torch.equal(a.get(out), b.get(out)) for a, b in zip(*recordings[:2], strict=True)
    ]
    assert sum(differs) > STEPS // 2


@each_case
def test_without_a_seed_torch_decides(name: str) -> None:
    actions = random_actions(STEPS, 2, 2)
    env = make_env(CASES[name], (2,), seed=None)
    recordings = []
    for _ in range(2):
        env.base_env.set_seed(3)
        torch.manual_seed(8)
        recordings.append(drive(env, actions))
    assert_same(*recordings)


@each_case
def test_two_episodes_in_a_row(name: str) -> None:
    """The second episode remembers nothing of the first, but draws other numbers."""
    env = make_env(CASES[name], (), seed=0)
    rollout = env.rollout(45, break_when_any_done=False)
    ends = rollout["next", "done"].squeeze(-1).nonzero().flatten()
    assert ends.tolist() == [19, 39]
    fresh = make_env(CASES[name], (), seed=0)
    first = fresh.rollout(45, policy=replay(rollout["action"]))
    assert_same([rollout[:20]], [first])
    second = fresh.rollout(45, policy=replay(rollout["action"][20:]))
    assert_same([rollout[20:40]], [second])


def replay(actions: torch.Tensor):
    steps = iter(actions)
    return lambda tensordict: tensordict.set("action", next(steps))


@each_case
def test_root_of_a_step_is_the_next_of_the_one_before(name: str) -> None:
    rollout = make_env(CASES[name], (2,)).rollout(15)
    for key in rollout["next"].keys(True, True):
        if key not in ("reward",):
            assert torch.equal(rollout["next", key][:, :-1], rollout[key][:, 1:]), key


@each_case
def test_clone_is_isolated(name: str) -> None:
    actions = random_actions(10, 2, 2)
    expected = drive(make_env(CASES[name], (2,)), actions)
    env = make_env(CASES[name], (2,))
    twin = TransformedEnv(PointMass([2], seed=0), env.transform.clone())
    other = env.transform.clone()
    drive(twin, actions)  # advances the twin's generators and memory, not the original's
    assert_same(drive(env, actions), expected)
    assert_same(drive(TransformedEnv(PointMass([2], seed=0), other), actions), expected)


@each_case
def test_clone_in_the_middle_of_an_episode(name: str) -> None:
    actions = random_actions(10, 2, 2)
    env = make_env(CASES[name], (2,))
    middle = drive(env, actions[:5])[-1]["next"]
    twin = TransformedEnv(copy.deepcopy(env.base_env), env.transform.clone())
    start = middle.exclude("reward")
    assert_same(drive(env, actions[5:], start=start.clone()), drive(twin, actions[5:], start=start))


@each_case
def test_state_dict_continues_exactly(name: str) -> None:
    actions = random_actions(10, 2, 2)
    env = make_env(CASES[name], (2,), seed=3)
    middle = drive(env, actions[:5])[-1]["next"].exclude("reward")
    file = io.BytesIO()
    torch.save(env.state_dict(), file)
    file.seek(0)
    again = TransformedEnv(copy.deepcopy(env.base_env), CASES[name](99))
    again.load_state_dict(torch.load(file, weights_only=True))
    expected = drive(env, actions[5:], start=middle.clone())
    assert_same(drive(again, actions[5:], start=middle), expected)


@each_case
def test_state_dict_continues_exactly_when_some_slots_are_reset(name: str) -> None:
    """What a slot that goes on shows at a reset of others is remembered, and so must be saved."""
    actions, resets = random_actions(6, 2, 2), torch.tensor([[True], [False]]).expand(6, 2, 1)
    env = make_env(CASES[name], (2,), seed=3)
    middle = drive(env, actions)[-1]["next"].exclude("reward")
    again = TransformedEnv(copy.deepcopy(env.base_env), CASES[name](99))
    again.load_state_dict(copy.deepcopy(env.state_dict()))
    reset = middle.clone().set("_reset", resets[0])
    assert_same([env.reset(reset.clone())], [again.reset(reset)])


def before_a_later_bias(seed: int | None) -> Transform:
    """Limit and controller measure at their own place, also at the start of an episode."""
    biases = ObservationNoise([POSITION], bias=0.2), ObservationNoise([POSITION], bias=0.3)
    limit, controlled = CASES["workspace_limit"](seed), CASES["residual_with_memory"](seed)
    return Compose(limit, biases[0], CASES["latency"](seed), controlled, biases[1])


DRAWS_AT_RESET = {"observation_noise", "observation_noise_beside", "chain"}
REFUSED = {"operated"}
UNDRAWN = {n: factory for n, factory in CASES.items() if n not in DRAWS_AT_RESET | REFUSED}


@pytest.mark.parametrize("factory", [*UNDRAWN.values(), before_a_later_bias])
def test_environment_that_resets_itself_equals_one_that_is_reset(factory: Factory) -> None:
    """But for its limits' flags, which are the last step's, and for noise on observations: such an
    environment has one observation less to draw."""
    own = TransformedEnv(ResetsItself((2,), episode_steps=5), factory(0))
    usual = TransformedEnv(PointMass((2,), episode_steps=5), factory(0))
    one, other = own.reset(), usual.reset()
    for action in random_actions(17, 2, 2):
        _, one = own.step_and_maybe_reset(one.set("action", action.clone()))
        _, other = usual.step_and_maybe_reset(other.set("action", action.clone()))
        keys = [key for key in usual.observation_spec.keys(True, True) if key[0] != "safety"]
        assert_same([one.select(*keys)], [other.select(*keys)])


@each_case
def test_state_dict_of_a_serial_env(name: str) -> None:
    actions = random_actions(6, 2, 2)
    env = SerialEnv(2, lambda: make_env(CASES[name]))
    middle = drive(env, actions[:3])[-1]["next"].exclude("reward")
    state = copy.deepcopy(env.state_dict())
    worlds = [copy.deepcopy(child.base_env) for child in env._envs]
    expected = drive(env, actions[3:], start=middle.clone())
    for child, world in zip(env._envs, worlds, strict=True):
        child.base_env = world
    env.load_state_dict(state)
    assert_same(drive(env, actions[3:], start=middle), expected)


@each_case
def test_pickle_in_the_middle(name: str) -> None:
    actions = random_actions(10, 2, 2)
    env = make_env(CASES[name], (2,))
    start = drive(env, actions[:5])[-1]["next"].exclude("reward")
    transform = env.transform.clone()
    again = TransformedEnv(copy.deepcopy(env.base_env), pickle.loads(pickle.dumps(transform)))
    expected = drive(env, actions[5:], start=start.clone())
    assert_same(drive(again, actions[5:], start=start), expected)


@each_case
def test_training_mode_changes_nothing(name: str) -> None:
    actions = random_actions(10, 2, 2)
    recordings = []
    for mode in (True, False):
        env = make_env(CASES[name], (2,))
        env.transform.train(mode)
        recordings.append(drive(env, actions))
    assert_same(*recordings)


@each_case
def test_slots_that_are_not_stepped_stand_still(name: str) -> None:
    """With "_step" a batch steps some of its slots; the others must not move on."""
    actions = random_actions(19, 2, 2)
    env, reference = make_env(CASES[name], (2,)), make_env(CASES[name], (2,))
    expected = drive(reference, actions)
    start = drive(env, actions[:4])[-1]["next"].exclude("reward")
    for _ in range(3):  # slot 0 alone goes on for a while, slot 1 waits
        td = start.clone().set("action", actions[4]).set("_step", torch.tensor([True, False]))
        waiting = env.step(td)[1]
        for key in env.observation_spec.keys(True, True):
            if key not in ("success", "executed_action"):
                assert torch.equal(waiting["next"].get(key), waiting.get(key)), key
    after = drive(env, actions[4:], start=start)
    for before, now in zip(expected[5:], after[1:], strict=True):
        assert_same([before[1]["next"]], [now[1]["next"]])
