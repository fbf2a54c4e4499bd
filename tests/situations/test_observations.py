"""Observation entries of every kind."""

from functools import partial

import pytest
import torch
from torchrl.data import Binary, Bounded, NonTensor, Unbounded

from situation_envs import Instructed, Machine, Simulator, Slow, batched

ENTRIES = {
    "image": Bounded(0, 255, (4, 4, 3), dtype=torch.uint8),
    "count": Unbounded((2,), dtype=torch.int64),
    "small count": Unbounded((2,), dtype=torch.int32),
    "contact": Binary(2, (2,), dtype=torch.bool),
    "precise": Unbounded((3,), dtype=torch.float64),
    "half": Unbounded((3,), dtype=torch.float16),
    ("arm", "joint", "position"): Unbounded((3,)),
    "one": Unbounded((1,)),
    "scalar": Unbounded(()),
    "true or false": Binary(shape=(), dtype=torch.bool),
    "matrix": Unbounded((2, 3)),
    "left/arm": Unbounded((2,)),
    "left arm": Unbounded((2,)),
    "left.arm": Unbounded((2,)),
    "links_é": Unbounded((2,)),
}


FLOATING = (torch.float16, torch.bfloat16, torch.float32, torch.float64)


@pytest.mark.parametrize("key", ENTRIES, ids=str)
def test_an_entry_is_learned_from(check_run, factory, key):
    _, _, stored = check_run(factory(partial(Simulator, {key: ENTRIES[key]}), [key]), True)
    assert stored[key].shape[1:] == ENTRIES[key].shape
    first, following = stored[key][0], stored["next"][key][0]
    assert first.dtype == (torch.float32 if key == "precise" else ENTRIES[key].dtype)
    assert not torch.equal(first, following) or ENTRIES[key].dtype not in FLOATING


@pytest.mark.parametrize("kind", [Slow, Machine], ids=["simulation", "machine"])
@pytest.mark.parametrize(
    "batching", ["serial", "native", pytest.param("parallel", marks=pytest.mark.slow)]
)
def test_all_entries_at_once_in_a_batch(check_run, factory, batching, kind):
    base = partial(kind, ENTRIES)
    base = partial(batched, base) if batching == "native" else base
    environment = factory(base, ENTRIES, batching=batching)
    simulation = kind is Slow
    _, _, stored = check_run(environment, simulation, num_envs=2, steps_per_collection=10)
    assert {key: stored[key].shape[1:] for key in ENTRIES} == {
        key: spec.shape for key, spec in ENTRIES.items()
    }


def test_text_beside_the_inputs_is_no_hindrance(check_run, factory):
    entries = {"position": Unbounded((2,)), "instruction": NonTensor(())}
    check_run(factory(partial(Machine, entries)))


@pytest.mark.parametrize("batching", ["serial", "native"])
def test_text_that_the_next_step_reads_is_there_again(check_run, factory, batching):
    entries = {"position": Unbounded((2,)), "instruction": NonTensor(())}
    base, often = partial(Instructed, entries), {"every": 30}  # in the middle of an episode
    if batching == "native":
        environment = factory(partial(batched, base), batching=batching)
        check_run(environment, True, num_envs=2, steps_per_collection=5, checkpoint=often)
    else:
        check_run(factory(base), True, steps_per_collection=10, checkpoint=often)


def test_text_as_an_input_is_refused_by_name(make_trainer, factory):
    entries = {"position": Unbounded((2,)), "instruction": NonTensor(())}
    environment = factory(partial(Machine, entries), ["position", "instruction"])
    with pytest.raises(TypeError, match=r"inputs\.instruction: expected numbers, got text"):
        make_trainer(environment).run()


@pytest.mark.parametrize("group", ["inputs", "critic_inputs"])
def test_the_action_as_an_input_is_refused_by_name(make_trainer, factory, group):
    entries = {"position": Unbounded((2,)), "action": Unbounded((2,))}
    environment = factory(partial(Machine, entries), **{group: ["position", "action"]})
    with pytest.raises(ValueError, match=r"inputs: expected no entry called 'action'.*rename it"):
        make_trainer(environment)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.uint16])
def test_numbers_that_cannot_be_stored_are_refused_by_name(make_trainer, factory, dtype):
    environment = factory(partial(Machine, {"position": Unbounded((2,), dtype=dtype)}))
    with pytest.raises(TypeError, match=rf"inputs\.position: expected .*got {dtype}"):
        make_trainer(environment)


def test_names_that_are_the_same_but_for_nesting(check_run, factory):
    entries = {key: Unbounded((2,)) for key in ("arm/x", ("arm", "x"), "arm.x", "[0]")}
    _, _, stored = check_run(factory(partial(Simulator, entries), list(entries)), True)
    assert {("arm", "x"), "arm/x"} <= set(stored.keys(True, True))


def image(*shape):
    return {"image": Bounded(0, 255, shape, dtype=torch.uint8)}


def test_a_buffer_takes_no_more_than_the_run_makes(check_run, factory):
    """Fifty million transitions of these would be 60 GB."""
    environment = factory(partial(Simulator, image(30, 40)), ["image"])
    check_run(environment, True, buffer_capacity=50_000_000)


@pytest.mark.parametrize("overlap", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_buffer_that_does_not_fit_into_memory_is_refused_at_once(
    make_trainer, factory, tmp_path, overlap
):
    environment = factory(partial(Machine, image(480, 640, 3)), ["image"])
    many = {
        "total_steps": 10**9,
        "buffer_capacity": 10**9,
        "collection": "overlap" if overlap else "turn",
    }
    expected = r"trainer\.buffer_capacity: expected .* the memory of cpu, .* GB, got 1000000000"
    with pytest.raises(ValueError, match=rf"{expected} of 921\.\d kB each, 921\.\d TB; keep fewer"):
        make_trainer(environment, **many)
    assert not list((tmp_path / "run").rglob("*.*"))
