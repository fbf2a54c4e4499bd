"""One generator for each slot."""

from __future__ import annotations

import copy
import pickle

import pytest
import torch

from rrl.slot_random import SlotGenerators


@pytest.mark.parametrize("stream", ["", "noise"])
@pytest.mark.parametrize("draw", ["normal", "uniform"])
def test_slot_equals_a_batch_of_one(draw: str, stream: str) -> None:
    batch = getattr(SlotGenerators(5, 4, stream), draw)((20, 3))
    for slot in range(4):
        alone = getattr(SlotGenerators(5 + slot, 1, stream), draw)((20, 3))
        assert torch.equal(batch[slot : slot + 1], alone)


def test_shape_type_and_range() -> None:
    generators = SlotGenerators(0, 3)
    assert generators.normal(()).shape == (3,)
    uniform = generators.uniform((1000,))
    assert uniform.dtype == torch.float32
    assert 0 <= uniform.min() < uniform.max() < 1


def test_masked_slots_stand_still() -> None:
    masked, plain = SlotGenerators(0, 2), SlotGenerators(0, 2)
    first = masked.normal((4,), torch.tensor([True, False]))
    assert torch.equal(first[1], torch.zeros(4))
    expected = plain.normal((4,))
    assert torch.equal(first[0], expected[0])
    assert torch.equal(masked.normal((4,))[1], expected[1])


def test_streams_are_unrelated() -> None:
    one, other = SlotGenerators(0, 1, "a").normal((50,)), SlotGenerators(0, 1, "b").normal((50,))
    assert torch.corrcoef(torch.cat([one, other]))[0, 1].abs() < 0.4


def test_seeds_beyond_32_bits_differ() -> None:
    small, large = SlotGenerators(3, 1, "a"), SlotGenerators(3 + 2**40, 1, "a")
    assert not torch.equal(small.normal((4,)), large.normal((4,)))


def test_without_a_seed_torch_decides() -> None:
    torch.manual_seed(1)
    one = SlotGenerators(None, 2).normal((3,))
    torch.manual_seed(1)
    assert torch.equal(one, SlotGenerators(None, 2).normal((3,)))
    assert not torch.equal(one, SlotGenerators(None, 2).normal((3,)))


def test_global_generator_is_left_alone_with_a_seed() -> None:
    before = torch.get_rng_state()
    SlotGenerators(0, 2).normal((3,))
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
    generators = SlotGenerators(7, 2, "a")
    if used:
        generators.normal((3,))
    twin = duplicate(generators)
    ahead = twin.normal((5,))
    twin.normal((5,))
    assert torch.equal(generators.normal((5,)), ahead)


def restored(generators: SlotGenerators) -> SlotGenerators:
    twin = SlotGenerators(None, 5, "a")
    twin.load_state_dict(generators.state_dict())
    return twin


def test_seed_starts_anew() -> None:
    generators = SlotGenerators(7, 2)
    first = generators.normal((3,))
    generators.seed(7)
    assert torch.equal(generators.normal((3,)), first)


@pytest.mark.parametrize("seed", [0.5, "1", True])
def test_bad_seed(seed) -> None:
    with pytest.raises(TypeError, match="seed: expected an integer or None"):
        SlotGenerators(seed, 1)


def test_bad_number_of_slots() -> None:
    with pytest.raises(ValueError, match="num_slots: expected"):
        SlotGenerators(0, 0)
