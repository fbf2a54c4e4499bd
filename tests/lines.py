"""A point on the way to its goal, as the environments of other people are: its state, its names, its types."""

import threading
from functools import partial

import numpy as np
import torch
from tensordict import NonTensorData, TensorDict
from torch import nn
from torchrl.data import Binary, Bounded, Composite, NonTensor, Unbounded
from torchrl.envs import EnvBase

from rrl.controllers import ProportionalController
from rrl.trainers import EnvironmentFactory, Input

EPISODE = 20


class Line(EnvBase):
    """A point without batch dimensions that knows its state as ``state_dict`` only."""

    position, goal = "position", "goal"

    def __init__(self, dtype=torch.float32):
        super().__init__(batch_size=[])
        shape = {"shape": [2], "dtype": dtype}
        self.observation_spec = Composite(
            {self.position: Unbounded(**shape), self.goal: Unbounded(**shape)}
        )
        self.action_spec = Bounded(-1.0, 1.0, [2], dtype=dtype)
        self.reward_spec = Unbounded([1], dtype=dtype)
        done = Binary(1, [1], dtype=torch.bool)
        names = ("done", "terminated", "truncated")
        self.full_done_spec = Composite({name: done.clone() for name in names})
        self.kind = dtype
        self.random, self.t, self.x = np.random.default_rng(0), 0, np.zeros(2)

    def _observe(self):
        x = torch.tensor(self.x, dtype=self.kind)
        return {self.position: x, self.goal: torch.ones(2, dtype=self.kind)}

    def _reset(self, tensordict=None, **kwargs):
        self.t, self.x = 0, self.random.random(2)
        return TensorDict(self._observe(), [])

    def _step(self, tensordict):
        action = tensordict["action"]
        assert action.dtype == self.kind
        self.t, self.x = self.t + 1, self.x + 0.1 * action.double().numpy()
        over = torch.tensor([self.t >= EPISODE])
        reward = -torch.tensor([np.abs(1 - self.x).sum()], dtype=self.kind)
        ends = {"done": over, "truncated": over.clone(), "terminated": torch.zeros_like(over)}
        return TensorDict({**self._observe(), "reward": reward, **ends}, [])

    def _set_seed(self, seed):
        self.random = np.random.default_rng(seed)

    def state_dict(self, *args, **kwargs):
        return {"x": self.x, "t": self.t, "random": self.random.bit_generator.state}

    def load_state_dict(self, state, *args, **kwargs):
        self.x, self.t = np.array(state["x"]), int(state["t"])
        self.random.bit_generator.state = state["random"]


class Scoring(Line):
    """A point for each step, counted in any type of numbers."""

    def __init__(self, reward):
        super().__init__()
        self.reward_spec = Unbounded([1], dtype=reward)
        self.score = torch.ones(1, dtype=reward)

    def _step(self, tensordict):
        return super()._step(tensordict).set("reward", self.score)


class Slashes(Line):
    position, goal = "arm/position", "arm/goal"


class Nested(Line):
    position, goal = ("arm", "position"), ("arm", "goal")


class LegacyGenerator(Line):
    """NumPy's old generator, a scalar of NumPy's and a count as a float."""

    def _set_seed(self, seed):
        self.random = np.random.RandomState(seed)

    def state_dict(self, *args, **kwargs):
        state = self.random.get_state()
        return {"x": self.x, "t": np.int64(self.t), "random": state, "clock": float(self.t)}

    def load_state_dict(self, state, *args, **kwargs):
        self.x, self.t = np.array(state["x"]), int(state["clock"])
        self.random.set_state(state["random"])


class Chatty(Line):
    """Text among the observations."""

    def __init__(self):
        super().__init__()
        self.observation_spec["camera"] = NonTensor(shape=[])

    def _observe(self):
        return {**super()._observe(), "camera": NonTensorData(f"step {self.t}")}


class Forgetful(Line):
    """No state at all."""

    def state_dict(self, *args, **kwargs):
        return {}


class OwnsANetwork(Forgetful):
    """Parameters and buffers, but nothing of the episode."""

    state_dict, load_state_dict = EnvBase.state_dict, EnvBase.load_state_dict

    def __init__(self):
        super().__init__()
        self.camera = nn.Sequential(nn.Linear(2, 2), nn.BatchNorm1d(2))


class ForgetsTheTime(Line):
    """A state that is given and taken but does not hold everything."""

    def load_state_dict(self, state, *args, **kwargs):
        pass


class RefusesItsState(Line):
    def load_state_dict(self, state, *args, **kwargs):
        raise NotImplementedError("not yet")


class KeepsAFile(Line):
    def state_dict(self, *args, **kwargs):
        return {**super().state_dict(), "devices": [{"handle": object()}]}


class HoldsALock(Line):
    """As a driver does: it cannot be copied."""

    lock = threading.Lock()

    def state_dict(self, *args, **kwargs):
        return {**super().state_dict(), "lock": self.lock}


def of(base, **arguments):
    """The factory of an environment; inputs are all that the point sees, and the controller's action."""
    inputs = {base.position: Input(), base.goal: Input(), "base_action": Input()}
    return EnvironmentFactory(
        partial(base, **arguments),
        partial(ProportionalController, base.position, base.goal, gain=0.5),
        inputs,
        batching="serial",
        max_episode_steps=EPISODE,
    )
