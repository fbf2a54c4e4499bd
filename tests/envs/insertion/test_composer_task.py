from __future__ import annotations

import dm_env
import numpy as np
import pytest

from insertion_helpers import act, random_actions
from rrl.envs import InsertionEnv, load


class Scripted(np.random.RandomState):
    """Draws what it is told to."""

    def __init__(self, unit: np.ndarray) -> None:
        super().__init__(0)
        self._unit = unit

    def uniform(self, low: float = 0.0, high: float = 1.0, size: int | None = None) -> np.ndarray:
        assert (low, high) == (0.0, 1.0) and size in (2, 5)
        return self._unit[:size]


@pytest.mark.parametrize(
    "yaw",
    [{}, {"yaw_range": 0.3}, {"place_range": (0.03, 0.03)}],
    ids=["preset", "uniform", "elsewhere"],
)
@pytest.mark.parametrize("seed", [0, 1])
def test_composer_and_batch_run_the_same_trajectory(variant: str, yaw: dict, seed: int) -> None:
    random = Scripted(np.random.default_rng(seed).uniform(size=5))
    single = load(f"insertion-{variant}", random_state=random, **yaw)
    batch = InsertionEnv(variant, **yaw)
    batch._generators = [random]
    contact = 0.0
    for episode in range(2):
        step, td = single.reset(), batch.reset()
        for action in random_actions(batch.config.episode_length, 1, seed=10 * seed + episode):
            assert_equal(step, td)
            step, td = single.step(action[0].numpy()), act(batch, action)
            contact = max(contact, td["metrics", "contact_force"].item())
        assert_equal(step, td)
        assert step.last() and step.discount == 1.0
        assert td["truncated"].all()
        nq = batch.slot_model(0).nq
        np.testing.assert_array_equal(
            single.physics.data.qpos, batch.physics_state()[0, 1 : nq + 1]
        )
    assert contact > 1.0


def assert_equal(step: dm_env.TimeStep, td) -> None:
    for name, value in step.observation.items():
        group, _, item = name.partition("/")
        key = (group, item) if item else name
        expected = td[key][0].numpy()
        np.testing.assert_array_equal(np.asarray(value, dtype=expected.dtype), expected, name)
    if step.reward is not None:
        assert np.float32(step.reward) == td["reward"].item()


def test_controller_solves_the_aligned_task(variant: str) -> None:
    env = load(f"insertion-{variant}", random_state=0, yaw_choices=(0.0,))
    step = env.reset()
    while not step.last():
        error = step.observation["goal"] - step.observation["end_effector_position"]
        step = env.step(np.clip(25 * error, -0.5, 0.5))
    assert step.observation["success"].all()
    assert not step.observation["diverged"].any()


def test_divergence_truncates_with_the_last_finite_observation(variant: str) -> None:
    env = load(f"insertion-{variant}", random_state=0)
    env.reset()
    before = env.step(np.array([0.0, 0.0, -0.5]))
    env.physics.data.qvel[-1] = np.nan
    step = env.step(np.zeros(3))
    assert step.last() and step.discount == 1.0
    assert step.observation["diverged"].all() and not before.observation["diverged"].any()
    np.testing.assert_array_equal(step.observation["blocks"], before.observation["blocks"])
    assert step.reward == before.reward
    assert not env.reset().observation["diverged"].any()
    assert not env.step(np.zeros(3)).observation["diverged"].any()


def test_bad_actions() -> None:
    env = load("insertion-sim", random_state=0)
    env.reset()
    with pytest.raises(ValueError, match="action: expected finite numbers"):
        env.step(np.array([0.0, np.nan, 0.0]))
    with pytest.raises(ValueError, match="action: expected shape"):
        env.step(np.zeros(2))


def test_random_state_reproduces(variant: str) -> None:
    one, two = (load(f"insertion-{variant}", random_state=3, yaw_range=0.3) for _ in range(2))
    for _ in range(2):
        a, b = one.reset().observation, two.reset().observation
        np.testing.assert_array_equal(a["blocks"], b["blocks"])


def test_unknown_name_lists_the_choices() -> None:
    with pytest.raises(
        ValueError, match=r"name: .*\['insertion-sim', 'insertion-real'\], got 'insertion'"
    ):
        load("insertion")
