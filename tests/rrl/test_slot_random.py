"""One generator for each slot."""

from __future__ import annotations

import copy
import pickle

import pytest
import torch

from rrl.slot_random import SlotGenerators

ONE, TWO = torch.Size([]), torch.Size([2])


@pytest.mark.parametrize("stream", ["", "noise"])
@pytest.mark.parametrize("draw", ["normal", "uniform"])
def test_slot_equals_a_batch_of_one(draw: str, stream: str) -> None:
    batch = getattr(SlotGenerators(5, stream), draw)(torch.Size([2, 2]), (20, 3))
    assert batch.shape == (2, 2, 20, 3)
    for slot in range(4):
        alone = getattr(SlotGenerators(5 + slot, stream), draw)(ONE, (20, 3))
        assert torch.equal(batch.flatten(0, 1)[slot], alone)


def test_type_and_range() -> None:
    uniform = SlotGenerators(0).uniform(torch.Size([3000]))
    assert uniform.dtype == torch.float32
    assert 0 <= uniform.min() < uniform.max() < 1


def test_masked_slots_stand_still() -> None:
    masked, plain = SlotGenerators(0), SlotGenerators(0)
    first = masked.normal(TWO, (4,), torch.tensor([True, False]))
    assert torch.equal(first[1], torch.zeros(4))
    expected = plain.normal(TWO, (4,))
    assert torch.equal(first[0], expected[0])
    assert torch.equal(masked.normal(TWO, (4,))[1], expected[1])


def test_another_number_of_slots_starts_anew() -> None:
    generators = SlotGenerators(0)
    first = generators.normal(TWO)
    generators.normal(ONE)
    assert torch.equal(generators.normal(TWO), first)


def test_streams_are_unrelated() -> None:
    one, other = (SlotGenerators(0, stream).normal(ONE, (50,)) for stream in "ab")
    assert torch.corrcoef(torch.stack([one, other]))[0, 1].abs() < 0.4


def test_seeds_beyond_32_bits_differ() -> None:
    small, large = SlotGenerators(3, "a"), SlotGenerators(3 + 2**40, "a")
    assert not torch.equal(small.normal(ONE, (4,)), large.normal(ONE, (4,)))


def test_without_a_seed_torch_decides() -> None:
    torch.manual_seed(1)
    one = SlotGenerators(None).normal(TWO, (3,))
    torch.manual_seed(1)
    assert torch.equal(one, SlotGenerators(None).normal(TWO, (3,)))
    assert not torch.equal(one, SlotGenerators(None).normal(TWO, (3,)))


def test_global_generator_is_left_alone_with_a_seed() -> None:
    before = torch.get_rng_state()
    SlotGenerators(0).normal(TWO, (3,))
    assert torch.equal(before, torch.get_rng_state())


@pytest.mark.parametrize(
    "duplicate",
    [
        copy.deepcopy,
        lambda generators: pickle.loads(pickle.dumps(generators)),
        lambda generators: restored(generators),
    ],
)
@pytest.mark.parametrize("used", [False, True])
def test_copies_continue_and_are_isolated(duplicate, used: bool) -> None:
    generators = SlotGenerators(7, "a")
    if used:
        generators.normal(TWO, (3,))
    twin = duplicate(generators)
    ahead = twin.normal(TWO, (5,))
    twin.normal(TWO, (5,))
    assert torch.equal(generators.normal(TWO, (5,)), ahead)


def restored(generators: SlotGenerators) -> SlotGenerators:
    twin = SlotGenerators(None, "a")
    twin.load_state_dict(generators.state_dict())
    return twin


def test_seed_starts_anew() -> None:
    generators = SlotGenerators(7)
    first = generators.normal(TWO, (3,))
    generators.seed(7)
    assert torch.equal(generators.normal(TWO, (3,)), first)


@pytest.mark.parametrize("seed", [0.5, "1", True])
def test_bad_seed(seed) -> None:
    with pytest.raises(TypeError, match="seed: expected an integer or None"):
        SlotGenerators(seed)
