"""Gymnasium: goal dictionaries, episodes that end apart, vectors that reset themselves."""

from functools import partial

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from torchrl.envs import GymWrapper

from rrl.controllers import ProportionalController

GOAL = ["observation", "achieved_goal", "desired_goal"]


class Reach(gymnasium.Env):
    """A point moves to a goal; an episode ends there, or after a random number of steps."""

    metadata = {"render_modes": []}  # noqa: RUF012 - as Gymnasium has it

    def __init__(self, longest=9, flat=False, lengths=None):
        def box(n):
            return gymnasium.spaces.Box(-5.0, 5.0, (n,), np.float64)

        self._dictionary = gymnasium.spaces.Dict(
            observation=box(4), achieved_goal=box(2), desired_goal=box(2)
        )
        self._flat, self._longest, self._lengths = flat, longest, lengths
        self.observation_space = box(4) if flat else self._dictionary
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.episodes = []

    def _observe(self):
        observation = np.concatenate([self._position, self._goal])
        if self._flat:
            return observation
        return {
            "observation": observation,
            "achieved_goal": self._position.copy(),
            "desired_goal": self._goal.copy(),
        }

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._position = np.zeros(2)
        self._goal = self.np_random.uniform(-1.0, 1.0, 2)
        self._left = self._lengths or int(self.np_random.integers(3, self._longest + 1))
        self.episodes.append(self._left)
        return self._observe(), {}

    def step(self, action):
        self._position = self._position + 0.1 * np.asarray(action, np.float64)
        self._left -= 1
        distance = float(np.linalg.norm(self._goal - self._position))
        return self._observe(), -distance, distance < 0.05, self._left == 0, {}


def wrapped(**arguments):
    return GymWrapper(Reach(**arguments))


def check_chain(stored, num_envs):
    """Within an episode the next observation is the following one; after its end the start."""
    position, following = (
        part["observation"][:, :2].unflatten(0, (-1, num_envs)) for part in (stored, stored["next"])
    )
    done = stored["next", "done"].unflatten(0, (-1, num_envs)).squeeze(-1)
    apart = (done.sum(-1) == 1).any()
    for slot in range(num_envs):
        for t in range(len(position) - 1):
            expected = torch.zeros(2) if done[t, slot] else following[t, slot]
            torch.testing.assert_close(position[t + 1, slot], expected.to(position))
            moved = (following[t, slot] - position[t, slot]).abs()
            assert (moved <= 0.1 + 1e-6).all(), "a step from one episode into another"
    return bool(apart)


def test_goal_dictionaries_of_two_whose_episodes_end_apart(check_run, factory):
    pd = partial(ProportionalController, "achieved_goal", "desired_goal", gain=0.5)
    environment = factory(wrapped, GOAL, controller=pd)
    _, resumed, stored = check_run(environment, num_envs=2, steps_per_collection=10)
    assert check_chain(stored[60:], 2)
    assert set(resumed.replay[:].keys()) >= {*GOAL, "action", "next"}


def test_a_single_goal_dictionary(check_run, factory):
    _, _, stored = check_run(factory(wrapped, GOAL))
    check_chain(stored[60:], 1)


def vector(mode, num_envs=1, wrapper=GymWrapper, **arguments):
    make = partial(Reach, **arguments)
    return wrapper(SyncVectorEnv([make] * num_envs, autoreset_mode=mode))


@pytest.mark.parametrize(
    ("mode", "flat"),
    # TorchRL takes no vector that resets in the next step, and no dictionary from one that resets
    # in the same.
    [
        (AutoresetMode.DISABLED, True),
        (AutoresetMode.DISABLED, False),
        (AutoresetMode.SAME_STEP, True),
    ],
    ids=["DISABLED-flat", "DISABLED-dictionary", "SAME_STEP-flat"],
)
def test_a_vector_that_resets_itself(check_run, factory, mode, flat):
    base = partial(vector, mode, flat=flat)
    environment = factory(base, GOAL[:1] if flat else GOAL, batching="native")
    _, _, stored = check_run(environment, num_envs=2, steps_per_collection=10)
    assert check_chain(stored[60:], 2)
