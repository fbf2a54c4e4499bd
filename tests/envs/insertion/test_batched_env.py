from __future__ import annotations

import copy
import io

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import ParallelEnv
from torchrl.envs.utils import check_env_specs

from insertion_helpers import act, assert_same, random_actions
from rrl.envs import InsertionEnv

DOWN = torch.tensor([0.0, 0.0, -1.0])


@pytest.mark.parametrize("num_envs", [1, 3])
def test_check_env_specs(variant: str, num_envs: int) -> None:
    env = InsertionEnv(variant, num_envs=num_envs)
    check_env_specs(env)
    assert env.batch_size == torch.Size([num_envs])
    types = {spec.dtype for spec in env.observation_spec.values(True, True)}
    assert types == {torch.float32, torch.bool}


def test_keys(variant: str) -> None:
    env = InsertionEnv(variant, num_envs=2)
    reset = env.reset()
    assert reset["blocks"].shape == (2, 13)
    assert ("wrench" in reset) == (variant == "sim")
    assert ("force_z" in reset) == (variant == "real")
    assert not reset["success"].any()
    assert "reward" not in reset
    stepped = act(env, DOWN)
    terms = stepped["reward_terms"]
    assert set(terms.keys()) == {"distance", "tilt"} | (
        {"displacement", "yaw"} if variant == "real" else set()
    )
    torch.testing.assert_close(sum(terms.values()), stepped["reward"])
    assert set(stepped["metrics"].keys()) == {"contact_force", "tilt"}
    assert stepped["metrics", "tilt"].shape == (2, 1)


def test_actions_in_double_precision_are_the_same(variant: str) -> None:
    single, double = (InsertionEnv(variant, seed=1) for _ in range(2))
    single.reset(), double.reset()
    assert_same(act(single, 0.5 * DOWN), act(double, 0.5 * DOWN.double()))


def test_slot_equals_a_batch_of_one(variant: str) -> None:
    batch = InsertionEnv(variant, num_envs=3, seed=5, yaw_range=0.3)
    singles = [InsertionEnv(variant, seed=5 + slot, yaw_range=0.3) for slot in range(3)]
    for _ in range(2):
        together = batch.reset()
        alone = [env.reset() for env in singles]
        assert_same(together, torch.cat(alone))
        for action in random_actions(20, 3):
            together = act(batch, action)
            alone = [act(env, action[slot]) for slot, env in enumerate(singles)]
            assert_same(together, torch.cat(alone))
    assert together["metrics", "contact_force"].max() > 0


def test_results_do_not_depend_on_threads(variant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    envs = [InsertionEnv(variant, num_envs=16, num_threads=n, yaw_range=0.3) for n in (1, 2)]
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    envs.append(InsertionEnv(variant, num_envs=16, yaw_range=0.3))
    assert [len(env._simulation._data) for env in envs] == [1, 2, 2]
    one, *others = [env.reset() for env in envs]
    for other in others:
        assert_same(one, other)
    for action in random_actions(20, 16):
        one, *others = [act(env, action) for env in envs]
        for other in others:
            assert_same(one, other)
    for env in envs:
        env.close()


def test_few_environments_get_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    threads = [len(InsertionEnv("sim", num_envs=n)._simulation._data) for n in (1, 15, 16, 80)]
    assert threads == [1, 1, 2, 4]


def test_seed_reproduces_and_slots_differ(variant: str) -> None:
    env = InsertionEnv(variant, num_envs=2, seed=1, yaw_range=0.3)
    first = [env.reset().clone() for _ in range(2)]
    env.set_seed(1)
    for reset in first:
        assert_same(env.reset(), reset)
    assert not torch.equal(first[0]["blocks"][0], first[0]["blocks"][1])
    assert not torch.equal(first[0]["blocks"], first[1]["blocks"])
    env.set_seed(2)
    assert torch.equal(env.reset()["blocks"][0], first[0]["blocks"][1])


def test_seed_none_follows_torch() -> None:
    resets = []
    for _ in range(2):
        torch.manual_seed(7)
        resets.append(InsertionEnv("sim", seed=None, yaw_range=0.3).reset())
    assert_same(*resets)


def test_partial_reset_touches_only_its_slots(variant: str) -> None:
    env = InsertionEnv(variant, num_envs=3, yaw_range=0.3)
    env.reset()
    for action in random_actions(10, 3):
        before = act(env, action)
    state = env.physics_state()
    mask = torch.tensor([[False], [True], [False]])
    after = env.reset(before.exclude("reward").set("_reset", mask))
    np.testing.assert_array_equal(env.physics_state()[[0, 2]], state[[0, 2]])
    assert env.physics_state()[1, 0] == 0
    unchanged = before.exclude("reward")[[0, 2]]
    assert_same(after[[0, 2]], unchanged)
    for key in ("blocks", "end_effector_position"):
        assert not torch.equal(after[key][1], before[key][1])
    for _ in range(39):
        done = act(env, DOWN)["done"].flatten().tolist()
        assert done == [False] * 3
    assert act(env, DOWN)["truncated"].flatten().tolist() == [True, False, True]


def test_step_mask_leaves_other_slots_alone(variant: str) -> None:
    env = InsertionEnv(variant, num_envs=2)
    env.reset()
    state = env.physics_state()
    mask = torch.tensor([[True], [False]])
    action = DOWN.expand(2, 3).clone()
    action[~mask.flatten()] = torch.nan  # nobody has chosen it
    env.step(TensorDict({"action": action, "_step": mask}, [2]))
    np.testing.assert_array_equal(env.physics_state()[1], state[1])
    assert (env.physics_state()[0] != state[0]).any()


def test_time_limit_truncates(variant: str) -> None:
    env = InsertionEnv(variant, num_envs=2, episode_length=4)
    rollout = env.rollout(10)
    assert rollout.shape == (2, 4)
    assert rollout["next", "truncated"][:, -1].all()
    assert not rollout["next", "truncated"][:, :-1].any()
    assert not rollout["next", "terminated"].any()


@pytest.mark.parametrize("blocks", ["planar", "free", "fixed"])
def test_block_kinds(variant: str, blocks: str) -> None:
    env = InsertionEnv(variant, num_envs=2, blocks=blocks, yaw_range=0.3)
    start = env.reset()["blocks"]
    for _ in range(25):
        end = act(env, DOWN)
    moved = (end["blocks"] - start)[:, :10].abs().max()
    assert moved < 1e-5 if blocks == "fixed" else moved > 1e-3


def test_force_and_contact_have_the_right_sign(variant: str) -> None:
    """Pressing on blocks that cannot give way pushes the tool up."""
    env = InsertionEnv(variant, blocks="fixed", yaw_choices=(20.0,))
    reset = env.reset()
    key, index = ("wrench", 2) if variant == "sim" else ("force_z", 0)
    assert reset[key].abs().max() < 0.1
    assert reset["metrics", "contact_force"].max() == 0
    for _ in range(25):
        end = act(env, 0.5 * DOWN)
    assert 5 < end[key][0, index] < 60
    contact = end["metrics", "contact_force"].item()
    assert contact == pytest.approx(end[key][0, index].item(), rel=0.2)


def test_controller_reaches_the_goal(variant: str) -> None:
    env = InsertionEnv(variant, num_envs=4, yaw_choices=(0.0,))
    td = env.reset()
    for _ in range(env.config.episode_length):
        td = act(env, (25 * (td["goal"] - td["end_effector_position"])).clamp(-0.5, 0.5))
    assert td["success"].all()
    assert td["metrics", "tilt"].max() < 0.02


def diverge(env: InsertionEnv, slot: int) -> None:
    """Give one slot a velocity that no physics survives."""
    env._simulation.state[slot, -1] = np.nan


@pytest.mark.parametrize("num_threads", [1, 2])
def test_divergence_is_flagged_counted_and_finite(variant: str, num_threads: int) -> None:
    env = InsertionEnv(variant, num_envs=3, num_threads=num_threads, yaw_range=0.3)
    env.reset()
    for action in random_actions(5, 3):
        before = act(env, action)
    twin = copy.deepcopy(env.state_dict())
    diverge(env, 1)
    after = act(env, DOWN)
    assert after["diverged"].flatten().tolist() == [False, True, False]
    assert after["truncated"].flatten().tolist() == [False, True, False]
    assert after["done"].flatten().tolist() == [False, True, False]
    for key, value in after.items(True, True):
        assert torch.isfinite(value.float()).all(), key
    for key in ("blocks", "reward", ("reward_terms", "distance")):
        assert torch.equal(after[key][1], before[key][1])
    # The others are as if nothing had happened, and a reset recovers the slot.
    healthy = InsertionEnv(variant, num_envs=3, yaw_range=0.3)
    healthy.load_state_dict(twin)
    assert torch.equal(act(healthy, DOWN)["blocks"][[0, 2]], after["blocks"][[0, 2]])
    env.reset(TensorDict({"_reset": after["done"]}, [3]))
    assert not act(env, DOWN)["diverged"].any()


def test_too_fast_counts_as_diverged(variant: str) -> None:
    env = InsertionEnv(variant, velocity_limit=0.05)
    env.reset()
    assert any(act(env, DOWN)["diverged"].item() for _ in range(3))


def test_divergence_leaves_no_log_file(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    env = InsertionEnv("sim")
    env.reset()
    diverge(env, 0)
    act(env, DOWN)
    assert list(tmp_path.iterdir()) == []


def test_state_dict_resumes_in_the_middle_of_an_episode(variant: str) -> None:
    env = InsertionEnv(variant, num_envs=2, yaw_range=0.3, seed=3)
    env.reset()
    for action in random_actions(12, 2):
        act(env, action)
    buffer = io.BytesIO()
    torch.save(env.state_dict(), buffer)
    buffer.seek(0)
    other = InsertionEnv(variant, num_envs=2, yaw_range=0.3, seed=99)
    other.load_state_dict(torch.load(buffer, weights_only=False))
    for action in random_actions(38, 2, seed=1):
        assert_same(act(env, action), act(other, action))
    assert_same(env.reset(), other.reset())
    assert_same(act(env, DOWN), act(other, DOWN))


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("physics", {"num_envs": 3}),
        ("physics", {"variant": "real"}),
        ("outputs/reward_terms/yaw", {"reward_weights": {"yaw": 0.1}}),
    ],
)
def test_state_of_another_environment_is_refused_before_anything_is_restored(name, other) -> None:
    state = InsertionEnv("sim", num_envs=2, seed=1).state_dict()
    env = InsertionEnv(**{"variant": "sim", "num_envs": 2, "seed": 2, **other})
    env.reset()
    before = env.physics_state()
    with pytest.raises(ValueError, match=f"expected {name} of shape .* same variant, num_envs"):
        env.load_state_dict(state)
    np.testing.assert_array_equal(env.physics_state(), before)


def make_env() -> InsertionEnv:
    return InsertionEnv("real", num_envs=1, seed=None)


@pytest.mark.slow
def test_in_workers() -> None:
    env = ParallelEnv(2, make_env)
    env.set_seed(0)
    first = env.rollout(2)
    env.set_seed(0)
    second = env.rollout(2)
    assert first.shape == (2, 1, 2)
    for key in ("blocks", "end_effector_position"):
        assert torch.equal(first[key][:, :, 0], second[key][:, :, 0])
    env.close()
