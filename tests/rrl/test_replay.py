"""Replay for stacked seeds: a seed sees its own transitions, whoever else is in the stack."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from rrl.replay import StackedSampler


def filled(num_seeds, seed=0, steps=40, batch_size=8):
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(1000), sampler=StackedSampler(num_seeds, seed, batch_size)
    )
    time = torch.arange(steps).repeat_interleave(num_seeds)
    owner = torch.arange(num_seeds).repeat(steps)
    buffer.extend(TensorDict({"time": time, "owner": owner}, [steps * num_seeds]))
    return buffer


def sample(buffer, k, num_seeds, batch_size=8):
    return buffer.sample(k * num_seeds * batch_size).reshape(k, num_seeds, batch_size)


def test_every_seed_draws_its_own_transitions():
    batches = sample(filled(3), 5, 3)
    assert torch.equal(batches["owner"], torch.arange(3).view(1, 3, 1).expand(5, 3, 8))


def test_a_seed_draws_alike_alone_and_in_a_stack():
    stack, alone = sample(filled(3, seed=4), 5, 3), sample(filled(1, seed=5), 5, 1)
    assert torch.equal(stack["time"][:, 1], alone["time"][:, 0])


def test_draws_cover_the_buffer_evenly():
    times = sample(filled(1), 1000, 1)["time"].flatten()
    counts = torch.bincount(times, minlength=40).float()
    assert counts.min() > 150  # 200 expected of each
    assert counts.max() < 250


def test_an_odd_number_of_samples_is_refused():
    with pytest.raises(ValueError, match="multiple of 3 seeds x 8 samples, got 10"):
        filled(3).sample(10)
