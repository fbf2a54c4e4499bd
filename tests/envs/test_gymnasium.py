"""Any Gymnasium environment: its success, its entries, its limits of time and of action."""

from __future__ import annotations

from functools import partial

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import SerialEnv, TransformedEnv
from torchrl.envs.utils import check_env_specs

from rrl.controllers import FunctionController
from rrl.envs import gymnasium_env
from rrl.transforms import ResidualAction

GOAL = {"observation", "achieved_goal", "desired_goal"}
STEP = 0.1


def box(size, bound=np.inf, dtype=np.float64):
    return gymnasium.spaces.Box(-bound, bound, (size,), dtype)


class Reach(gymnasium.Env):
    """A point moves to a goal; its info says whether it is there."""

    metadata = {"render_modes": []}  # noqa: RUF012 - as Gymnasium has it

    def __init__(self, bound=1.0, dtype=np.float64, flat=False, obeys=True):
        spaces = {"observation": box(4), "achieved_goal": box(2), "desired_goal": box(2)}
        self.observation_space = box(4) if flat else gymnasium.spaces.Dict(spaces)
        self.action_space = box(2, bound, dtype)
        self._flat, self._obeys, self.taken = flat, obeys, []
        self.random = np.random.default_rng()

    def _observe(self):
        observation = np.concatenate([self.position, self.goal])
        goals = {"achieved_goal": self.position.copy(), "desired_goal": self.goal.copy()}
        return observation if self._flat else {"observation": observation, **goals}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        if seed is not None and self._obeys:
            self.random = np.random.default_rng(seed)
        self.position, self.goal = np.zeros(2), self.random.uniform(-0.2, 0.2, 2)
        return self._observe(), {}

    def step(self, action):
        self.taken.append(action)
        self.position = self.position + STEP * np.asarray(action, np.float64)
        distance = float(np.linalg.norm(self.goal - self.position))
        return self._observe(), -distance, False, False, {"is_success": distance < 0.05}


def pd(achieved, desired):
    return np.clip((desired - achieved) / STEP, -1.0, 1.0)


def with_residual(env, controller=pd, keys=("achieved_goal", "desired_goal")):
    return TransformedEnv(env, ResidualAction(FunctionController(controller, keys), scale=0.0))


def reach(**arguments):
    return gymnasium_env(Reach, success="is_success", max_episode_steps=6, **arguments)


def there_and_back(achieved, desired):
    """Reach the goal in two steps at most, then leave it."""
    if np.linalg.norm(desired - achieved) < 1e-6:
        return np.ones(2)
    return pd(achieved, desired)


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("bound", [1.0, 0.5, np.inf])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_specs(flat, bound, dtype) -> None:
    env = reach(bound=bound, dtype=dtype, flat=flat)
    check_env_specs(env)
    entries = {"observation"} if flat else GOAL
    assert set(env.observation_spec.keys()) == entries | {"success"}
    assert env.action_spec.dtype == torch.tensor(dtype(0)).dtype
    assert env.observation_spec["observation"].dtype == torch.float64


@pytest.mark.parametrize("names", [("state",), ("state", "goal"), ("state", "observation")])
def test_entries_keep_their_names(names) -> None:
    class Named(Reach):
        def __init__(self):
            super().__init__(flat=True)
            spaces = dict.fromkeys(names, self.observation_space)
            self.observation_space = gymnasium.spaces.Dict(spaces)

        def _observe(self):
            return dict.fromkeys(names, super()._observe())

    env = gymnasium_env(Named, success="is_success", max_episode_steps=6)
    check_env_specs(env)
    assert set(env.observation_spec.keys()) == {*names, "success"}
    assert env.rollout(2)["next", "state"].shape == (2, 4)


def test_entries_of_groups_keep_their_names_too() -> None:
    class Grouped(Reach):
        def __init__(self):
            super().__init__(flat=True)
            arm = gymnasium.spaces.Dict({"state": self.observation_space})
            self.observation_space = gymnasium.spaces.Dict({"arm": arm, "state": arm})

        def _observe(self):
            arm = {"state": super()._observe()}
            return {"arm": arm, "state": arm}

    env = gymnasium_env(Grouped, success="is_success", max_episode_steps=6)
    check_env_specs(env)
    following = env.rollout(2)["next"]
    assert following["arm", "state"].shape == following["state", "state"].shape == (2, 4)


def test_success_is_what_info_says() -> None:
    """A step or two lead to the goal; a reset is no success."""
    rollout = with_residual(reach()).rollout(6)
    assert not rollout["success"][0]
    assert rollout["next", "success"][2:].all()
    distance = (rollout["next", "desired_goal"] - rollout["next", "achieved_goal"]).norm(dim=-1)
    assert torch.equal(rollout["next", "success"].squeeze(-1), distance < 0.05)


@pytest.mark.parametrize("any_time", [False, True])
def test_success_of_the_last_state_or_of_any(any_time) -> None:
    env = with_residual(reach(any_time=any_time), there_and_back)
    for _ in range(2):  # the second episode does not inherit the first one's success
        rollout = env.rollout(4)
        solved = rollout["next", "success"].squeeze(-1)
        assert not rollout["success"][0]
        assert solved.any()
        last = (rollout["next", "desired_goal"] - rollout["next", "achieved_goal"])[-1]
        assert bool(solved[-1]) == (any_time or bool(last.norm() < 0.05))


def test_success_as_a_function_of_the_environment() -> None:
    env = gymnasium_env(Reach, success=lambda e: abs(e.position[0]) > 0.15, max_episode_steps=3)
    assert isinstance(env.unwrapped.taken, list)
    rollout = TransformedEnv(
        env, ResidualAction(FunctionController(lambda o: np.ones(2)), scale=0.0)
    ).rollout(3)
    assert rollout["next", "success"].flatten().tolist() == [False, True, True]


@pytest.mark.parametrize("told", [0.3, "yes", 2])
def test_success_is_a_flag(told) -> None:
    class Shares(Reach):
        def step(self, action):
            *outcome, info = super().step(action)
            return *outcome, {**info, "share": told}

    for success in ("share", lambda _: told):
        with pytest.raises(ValueError, match=f"success: expected a flag, 0 or 1, got {told!r}"):
            gymnasium_env(Shares, success=success).rollout(1)
    assert not gymnasium_env(Reach, success=lambda _: np.nan).rollout(1)["next", "success"].any()


def test_without_success_there_is_no_such_entry() -> None:
    assert "success" not in gymnasium_env(Reach).observation_spec.keys()  # noqa: SIM118
    assert "success" not in gymnasium_env("Pendulum-v1").reset()


def test_a_step_before_the_first_reset_is_as_the_environment_has_it() -> None:
    class Ready(Reach):
        position, goal = np.zeros(2), np.ones(2)

    env = gymnasium_env(Ready, success="is_success")
    following = env.step(TensorDict({"action": torch.zeros(2, dtype=torch.float64)}))["next"]
    assert not following["success"].any()
    env = gymnasium_env(Ready)
    env.step(TensorDict({"action": torch.zeros(2, dtype=torch.float64)}))


def test_success_that_info_lacks() -> None:
    env = gymnasium_env(Reach, success="success", max_episode_steps=5)
    assert not env.rollout(4)["next", "success"].any()
    with pytest.raises(KeyError, match=r"end, which has .*'is_success'.*, got 'success'"):
        env.rollout(20)


class SaysItLate(gymnasium.Wrapper):
    """Says whether it succeeded when the episode is over."""

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        info = {"is_success": True} if truncated else {}
        return observation, reward, terminated, truncated, info


def test_success_that_info_has_at_the_end_alone() -> None:
    make = lambda: SaysItLate(gymnasium.wrappers.TimeLimit(Reach(), 3))  # noqa: E731
    rollout = gymnasium_env(make, success="is_success").rollout(10)
    assert rollout["next", "success"].flatten().tolist() == [False, False, True]


@pytest.mark.parametrize("make", [Reach, "Pendulum-v1"], ids=["function", "name"])
def test_time_limit(make) -> None:
    rollout = gymnasium_env(make, max_episode_steps=5).rollout(20)
    assert rollout.shape == (5,)
    assert rollout["next", "truncated"].flatten().tolist() == [False] * 4 + [True]
    assert not rollout["next", "terminated"].any()


def test_episodes_of_several_end_apart_and_start_again() -> None:
    make = partial(gymnasium_env, Reach, success="is_success")
    env = SerialEnv(2, [partial(make, max_episode_steps=n) for n in (3, 5)])
    rollout = with_residual(env).rollout(15, break_when_any_done=False)
    ends = rollout["next", "done"].squeeze(-1)
    assert [slot.nonzero().flatten().tolist() for slot in ends] == [[2, 5, 8, 11, 14], [4, 9, 14]]
    starts = rollout["achieved_goal"][:, 1:][ends[:, :-1]]
    assert (starts == 0).all()
    assert not rollout["success"][:, 1:][ends[:, :-1]].any()


@pytest.mark.parametrize("bound", [0.5, np.inf])
def test_actions_with_and_without_bounds(bound) -> None:
    """Bounds clip; without bounds everything passes. A unit of residual is half the range, or 1."""
    controller = FunctionController(lambda observation: np.array([0.3, 2.0]))
    env = TransformedEnv(reach(bound=bound), ResidualAction(controller))
    env.rollout(1, lambda td: td.set("action", torch.tensor([0.1, 0.0], dtype=torch.float64)))
    taken = env.base_env.unwrapped.taken[0]
    assert np.allclose(taken, [0.35, 0.5] if bound == 0.5 else [0.4, 2.0], atol=1e-12)


def test_double_precision_reaches_the_environment() -> None:
    env = with_residual(reach())
    env.rollout(1)
    taken = env.base_env.unwrapped.taken[0]
    goal = env.base_env.unwrapped.goal
    assert taken.dtype == np.float64
    assert np.array_equal(taken, np.clip(goal / STEP, -1.0, 1.0))


@pytest.mark.parametrize("obeys", [True, False])
def test_equal_seeds_equal_episodes(obeys) -> None:
    """By reset's seed; by a function where the environment ignores it."""

    def own(env, number):
        env.random = np.random.default_rng(number)

    env = reach(obeys=obeys, seed=None if obeys else own)
    goals = []
    for number in (1, 1, 2):
        env.set_seed(number)
        goals.append(torch.stack([env.reset()["desired_goal"] for _ in range(2)]))
    assert torch.equal(goals[0], goals[1])
    assert not torch.equal(goals[0], goals[2])
    assert not torch.equal(*goals[0])


def test_state_for_videos() -> None:
    env = reach(state=lambda e: e.goal)
    env.reset()
    assert np.array_equal(env.physics_state(), env.unwrapped.goal)
    with pytest.raises(TypeError, match="expected an environment with a MuJoCo model"):
        reach().physics_state()


@pytest.mark.parametrize(("given", "got"), [(Reach(), "an environment"), (3, "a int")])
def test_what_makes_no_environment(given, got) -> None:
    message = f"make: expected a name or a function that makes it, got {got}; every slot"
    with pytest.raises(TypeError, match=message):
        gymnasium_env(given, success="is_success")


def test_what_is_no_environment() -> None:
    with pytest.raises(TypeError, match=r"one gymnasium\.Env, got a SyncVectorEnv; batching"):
        gymnasium_env(partial(gymnasium.make_vec, "Pendulum-v1", num_envs=2))
