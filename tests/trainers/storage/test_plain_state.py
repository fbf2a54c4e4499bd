"""What a state may hold: it comes back as it was, or is refused by its place."""

import io
import pathlib
import random
from collections import OrderedDict, namedtuple

import numpy as np
import pytest
import torch
from tensordict import NonTensorData, NonTensorStack, TensorDict

from rrl.trainers.storage.plain_state import entries, from_plain, to_plain

KEPT = {
    "generator": np.random.default_rng(3).bit_generator.state,
    "old generator": np.random.RandomState(3).get_state(),
    "Python's generator": random.Random(3).getstate(),
    "numbers": ((1, 2.5), [np.float32(3), None, 2**100, True]),
    "arrays": [np.zeros((0, 3)), np.array([1 + 2j]), np.array(3.0), np.arange(4)[::2]],
    "bytes and text": {"a/b": b"x", ("c", "d"): "é"},
    "ordered": OrderedDict(a=torch.zeros(2)),
}
REFUSED = {
    "records": (np.zeros(2, dtype=[("a", "f4")]), r"NumPy array of \[\('a', '<f4'\)\]"),
    "text array": (np.array(["a"]), "NumPy array of <U1"),
    "objects": (np.array([object()]), "NumPy array of object"),
    "path": (pathlib.PurePosixPath("x"), "a PurePosixPath"),
    "set": ({1}, "a set"),
    "key": ({2.5: 1}, "a key of type float"),
}


def same(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(v, other[k]) for k, v in one.items())
    if isinstance(one, (list, tuple)):
        return type(one) is type(other) and all(map(same, one, other))
    if isinstance(one, (np.ndarray, torch.Tensor)):
        return type(one) is type(other) and one.shape == other.shape and bool((one == other).all())
    return type(one) is type(other) and one == other


@pytest.mark.parametrize("name", KEPT)
def test_it_is_loaded_as_it_was_saved(name):
    file = io.BytesIO()
    torch.save(to_plain(KEPT[name]), file)
    file.seek(0)
    loaded = from_plain(torch.load(file, weights_only=True))
    assert same(dict(loaded) if isinstance(loaded, dict) else loaded, KEPT[name])


def test_of_a_tensordict_tensors_and_text_are_kept():
    root = TensorDict({"x": torch.ones(2, 1), "arm": {"x": torch.zeros(2)}}, [2])
    root.set("task", NonTensorData("insert", [2])).set("arm/said", NonTensorStack("a", "b"))
    root.set("handle", NonTensorData(pathlib.PurePosixPath("x"), [2]))
    kept = TensorDict(from_plain(to_plain(entries(root))), [2])
    assert set(kept.keys(True)) == set(root.keys(True)) - {"handle"}
    assert torch.equal(kept["x"], root["x"])
    assert torch.equal(kept["arm", "x"], root["arm", "x"])
    assert kept["task"] == "insert"
    assert [each["arm/said"] for each in kept] == ["a", "b"]


def test_a_named_tuple_becomes_a_tuple():
    assert to_plain(namedtuple("Pose", "x y")(1, 2)) == (1, 2)


@pytest.mark.parametrize("name", REFUSED)
def test_it_is_refused_by_its_place(name):
    value, what = REFUSED[name]
    with pytest.raises(TypeError, match=rf"state\['arm'\]\[0\].*: expected .*, got .*{what}"):
        to_plain({"arm": [value]})
