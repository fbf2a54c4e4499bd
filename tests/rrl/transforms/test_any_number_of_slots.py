"""Environments without a batch size of their own, which take whatever number of slots comes."""

from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv

from transform_cases import CASES, POSITION, assert_same, drive, random_actions

SLOTS = (3,)


class Stateless(EnvBase):
    """A point whose whole state is in the observations, as in TorchRL's tutorial on pendulums."""

    batch_locked = False

    def __init__(self, batch: tuple[int, ...] = ()) -> None:
        super().__init__(batch_size=batch)
        vector, flag = Unbounded((*batch, 2)), Binary(1, (*batch, 1), dtype=torch.bool)
        entries = {POSITION: vector, "goal": vector.clone(), "success": flag}
        self.observation_spec = Composite(entries, shape=batch)
        self.state_spec = self.observation_spec.clone()
        self.action_spec = Bounded(-1.0, 1.0, (*batch, 2))
        self.reward_spec = Unbounded((*batch, 1))

    def _seen(self, position: torch.Tensor, goal: torch.Tensor, **others) -> TensorDict:
        distance = (goal - position).norm(dim=-1, keepdim=True)
        entries = {POSITION: position, "goal": goal, "success": distance < 0.1}
        return TensorDict({**entries, **others}, position.shape[:-1])

    def _reset(self, tensordict=None) -> TensorDict:
        shape = (*self.batch_size, 2) if tensordict is None else (*tensordict.batch_size, 2)
        position, goal = torch.linspace(-0.4, 0.4, 12)[: 2 * torch.Size(shape).numel()].chunk(2)
        return self._seen(position.reshape(shape), goal.reshape(shape))

    def _step(self, tensordict) -> TensorDict:
        position = tensordict[POSITION] + 0.1 * tensordict["action"]
        never = torch.zeros(*tensordict.batch_size, 1, dtype=torch.bool)
        ends = {"done": never, "terminated": never.clone()}
        return self._seen(position, tensordict["goal"], reward=position[..., :1], **ends)

    def _set_seed(self, seed) -> None:
        pass


@pytest.mark.parametrize("name", CASES)
def test_slots_that_come_are_those_of_a_batch(name: str) -> None:
    actions = random_actions(12, *SLOTS, 2)
    free, batched = (TransformedEnv(Stateless(b), CASES[name](0)) for b in ((), SLOTS))
    expected = drive(batched, actions)
    start = free.reset(TensorDict({}, SLOTS))
    assert_same(drive(free, actions, start=start), expected)
