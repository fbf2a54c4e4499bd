"""Environments as other people write them, for tests/situations: odd entries, actions, habits."""

from __future__ import annotations

import os
import random
import time

import numpy as np
import torch
from tensordict import NonTensorData, TensorDict
from torchrl.data import Binary, Bounded, Composite, NonTensor, Unbounded
from torchrl.envs import EnvBase

LENGTH = 8  # steps of an episode


class Machine(EnvBase):
    """Counts its steps; every observation entry is made of the count and of the last action.

    Args:
        entries: Specs of observation entries by key, without batch dimensions.
        action: Spec of the action, without batch dimensions.
        action_key: Where the action is read.
        batch_size: [] or [num_envs].
        ending: "truncated" or "terminated" after LENGTH steps.
    """

    def __init__(
        self,
        entries=None,
        action=None,
        action_key="action",
        batch_size=(),
        ending="truncated",
    ):
        super().__init__(batch_size=torch.Size(batch_size), device="cpu")
        batch = self.batch_size
        entries = {"position": Unbounded((2,))} if entries is None else entries
        action = Bounded(-1.0, 1.0, (2,)) if action is None else action
        self._ending, self._key = ending, action_key
        specs = Composite(shape=batch)
        for key, spec in entries.items():
            specs[key] = spec.expand(*batch, *spec.shape)
        self.observation_spec = specs
        self.full_action_spec = Composite(
            {action_key: action.expand(*batch, *action.shape)}, shape=batch
        )
        self.reward_spec = Unbounded((*batch, 1))
        done = Binary(1, (*batch, 1), dtype=torch.bool)
        self.full_done_spec = Composite(
            done=done, terminated=done.clone(), truncated=done.clone(), shape=batch
        )
        self._count = torch.zeros(*batch, 1, dtype=torch.int64)
        self._push = torch.zeros(*batch, 1)
        self._offset = 0

    def _observe(self):
        out = TensorDict(batch_size=self.batch_size)
        for key in self.observation_spec.keys(True, True):
            spec = self.observation_spec[key]
            if isinstance(spec, NonTensor):
                out.set(key, NonTensorData(f"step {int(self._count.max())}", self.batch_size))
                continue
            value = self._count.float() / LENGTH + self._push + self._offset
            extra = spec.ndim - len(self.batch_size)
            value = value.reshape((*self.batch_size, *[1] * extra)).expand(spec.shape)
            out.set(key, value > 0.5 if spec.dtype == torch.bool else value.abs().to(spec.dtype))
        return out

    def _reset(self, tensordict=None, **kwargs):
        mask = None if tensordict is None else tensordict.get("_reset", None)
        mask = torch.ones_like(self._count, dtype=torch.bool) if mask is None else mask
        mask = mask.reshape(self._count.shape)
        self._count = torch.where(mask, 0, self._count)
        self._push = torch.where(mask, 0.0, self._push)
        return self._observe()

    def _step(self, tensordict):
        action = tensordict.get(self._key)
        assert action.dtype == self.full_action_spec[self._key].dtype
        assert action.shape == self.full_action_spec[self._key].shape
        assert self.full_action_spec.is_in(tensordict.select(self._key))
        self._push = action.reshape(*self.batch_size, -1).float().mean(-1, keepdim=True)
        self._count = self._count + 1
        ended = self._count >= LENGTH
        out = self._observe()
        out.update(
            {
                "reward": 1.0 - self._push.square(),
                "done": ended,
                "terminated": ended & (self._ending == "terminated"),
                "truncated": ended & (self._ending == "truncated"),
            }
        )
        return out

    def _set_seed(self, seed):
        self._offset = 0.0 if seed is None else seed % 7 / 7


class Simulator(Machine):
    """One whose state can be saved."""

    def get_extra_state(self):
        return {"count": self._count, "push": self._push, "offset": self._offset}

    def set_extra_state(self, state):
        self._count, self._push, self._offset = state["count"], state["push"], state["offset"]


class Instructed(Simulator):
    """Its step reads the text that the observation before it said."""

    def _step(self, tensordict):
        assert tensordict["instruction"] == f"step {int(self._count.max())}"
        return super()._step(tensordict)


class Slow(Simulator):
    """One that takes its time, so that nobody can read a step before it is made."""

    def _step(self, tensordict):
        time.sleep(0.005)
        return super()._step(tensordict)


def batched(make, num_envs=1, **arguments):
    """The native batch of such an environment."""
    return make(batch_size=[num_envs], **arguments)


class Careless(Machine):
    """Its resets and steps draw from the global generators of Python, NumPy and torch."""

    def _reset(self, tensordict=None, **kwargs):
        out = super()._reset(tensordict, **kwargs)
        self._start = random.random() + np.random.rand() + float(torch.rand(()))  # noqa: NPY002
        return out.update({"position": out["position"] + self._start})

    def _step(self, tensordict):
        out = super()._step(tensordict)
        return out.update({"reward": out["reward"] + self._start + torch.randn(())})


class Failing(Machine):
    """Raises, or its process dies, in its step number ``at`` if there is the file ``marker``."""

    def __init__(self, at, how, marker=None, **arguments):
        super().__init__(**arguments)
        self._at, self._how, self._marker, self._steps = at, how, marker, 0

    def _step(self, tensordict):
        self._steps += 1
        if self._steps == self._at and self._first():
            if self._how == "die":
                os._exit(9)
            raise {"raise": ValueError, "exit": SystemExit}[self._how]("the motor is too hot")
        return super()._step(tensordict)

    def _first(self):
        """Whether this is the first of the workers that comes here; of two at once, one is."""
        try:
            self._marker.unlink()
        except (AttributeError, FileNotFoundError):
            return False
        return True


def black(env, states, width=64, height=48, camera=None):
    """Frames of a renderer that needs no graphics."""
    return np.zeros((len(states), height, width, 3), dtype=np.uint8)
