"""Memory of objects: saved as plain data and restored to the same kind, or refused by name."""

from __future__ import annotations

import threading
from collections import deque, namedtuple

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn

from rrl.controllers import FunctionController
from rrl.trainers.storage.plain_state import from_plain, to_plain

KEYS = ["end_effector_position", "goal"]


def state(batch) -> TensorDict:
    values = {key: torch.rand(*batch, 2) for key in KEYS}
    return TensorDict(values, batch_size=batch)


class Counter:
    """Remembers how often it acted in the episode."""

    def reset(self):
        self.count = 0

    def act(self, position):
        self.count += 1
        return np.full(2, self.count)


class WithStateDict(Counter):
    def state_dict(self):
        return {"count": self.count}

    def load_state_dict(self, saved):
        self.count = saved["count"]


def law(error):
    return 0.5 * error


class Noisy:
    """A moving average with noise: what it remembers is no plain list of numbers."""

    law = staticmethod(law)

    def __init__(self, generator):
        self.random, self.use = np.random.Generator(generator), law

    def reset(self):
        self.last, self.seen = (0, np.zeros(2)), {"positions": deque(maxlen=3), "all": deque()}

    def act(self, position):
        for each in self.seen.values():
            each.append(position)
        self.last = (self.last[0] + 1, position)
        mean = np.mean(self.seen["positions"], axis=0) + len(self.seen["all"])
        return self.use(mean) + self.last[0] * self.last[1] + self.random.normal(size=2)


GENERATORS = [np.random.PCG64, np.random.MT19937, np.random.Philox, np.random.SFC64]


@pytest.mark.parametrize("kind", GENERATORS)
def test_memory_of_every_kind_is_saved_as_plain_data(kind, tmp_path) -> None:
    controller = FunctionController(Noisy(kind(1)), KEYS[:1])
    for _ in range(5):
        controller.act(state([2]))
    torch.save(to_plain(controller.state_dict()), tmp_path / "state.pt")
    data = [state([2]) for _ in range(5)]
    expected = [controller.act(each) for each in data]
    other = FunctionController(Noisy(kind(2)), KEYS[:1])
    other.load_state_dict(from_plain(torch.load(tmp_path / "state.pt", weights_only=True)))
    for each, action in zip(data, expected, strict=True):
        assert torch.equal(other.act(each), action)


Pose = namedtuple("Pose", "x y")
REFUSED = {
    "set": ({1}, r"attribute seen: expected .*, got a set"),
    "nested": (
        {"all": [deque([{1}])]},
        r"attribute seen\['all'\]\[0\]\[0\]: expected .*, got a set",
    ),
    "named tuple": (Pose(1, 2), "attribute seen: expected .*, got a Pose"),
    "generator": ((i for i in range(3)), "attribute seen: expected .*, got a generator"),
    "lock": (threading.Lock(), "attribute seen: expected .*, got a lock"),
    "old generator": (np.random.RandomState(0), "attribute seen: .*, got a RandomState"),
    "objects": (np.array([None]), "attribute seen: expected .*, got a ndarray of object"),
    "key": ({0.5: 1}, "attribute seen: expected .*, got a dict"),
}


class Holds(Counter):
    """Remembers something from the start, from the reset, or from the first step on."""

    def __init__(self, thing, when):
        self.when = when
        self._take(thing, "init")
        self._make = (lambda: thing) if when != "init" else None

    def _take(self, thing, now):
        if now == self.when:
            self.seen = thing

    def reset(self):
        super().reset()
        if self.when == "reset":
            self.seen = self._make()

    def act(self, position):
        if self.when == "act":
            self.seen = self._make()
        return super().act(position)


@pytest.mark.parametrize("when", ["init", "reset", "act"])
@pytest.mark.parametrize("name", REFUSED)
def test_memory_that_cannot_be_saved_is_refused_at_once(name, when) -> None:
    thing, message = REFUSED[name]
    with pytest.raises(TypeError, match=f"^controller Holds: {message}.*; give it state_dict"):
        controller = FunctionController(Holds(thing, when), KEYS[:1])
        assert when != "init"
        controller.act(state([2]))


def test_a_state_dict_that_cannot_be_saved_is_refused_at_first_use() -> None:
    class Hides(WithStateDict):
        def state_dict(self):
            return {"seen": {1}}

    with pytest.raises(
        TypeError, match=r"controller Hides: state_dict\(\)\['seen'\]: .* a set; let"
    ):
        FunctionController(Hides, KEYS[:1]).act(state([2]))


class Recurrent(nn.Module):
    """A network with a hidden state, a count and a mean that is no part of its state_dict."""

    def __init__(self):
        super().__init__()
        self.cell, self.head, self.law = nn.GRUCell(2, 8), nn.Linear(8, 2), law
        self.register_buffer("mean", torch.zeros(2), persistent=False)
        self.reset()

    def reset(self):
        self.hidden, self.count = torch.zeros(8), 0
        self.mean.zero_()

    def forward(self, position, goal):
        self.count += 1
        self.mean += (position - self.mean) / self.count
        self.hidden = self.cell((goal - self.mean)[None], self.hidden[None])[0]
        return self.head(self.hidden)


def test_a_network_remembers_what_it_holds_beside_its_weights(tmp_path) -> None:
    torch.manual_seed(0)
    network = Recurrent()
    one, other = (FunctionController(network, KEYS) for _ in range(2))
    for _ in range(3):
        one.act(state([2]))
    torch.save(one.state_dict(), tmp_path / "saved.pt")
    other.load_state_dict(torch.load(tmp_path / "saved.pt", weights_only=True))
    for _ in range(3):
        seen = state([2])
        with one.only(torch.tensor([True, False])):  # copies what is remembered
            acts = one.act(seen)
        with other.only(torch.tensor([True, False])):
            assert torch.equal(acts, other.act(seen))
    assert not acts.requires_grad


def test_an_object_that_cannot_be_copied_is_named() -> None:
    class Locked(WithStateDict):
        def __init__(self):
            self.lock = threading.Lock()

    with pytest.raises(
        TypeError, match=r"controller Locked: .*cannot pickle.*; give it __deepcopy"
    ):
        FunctionController(Locked, KEYS[:1]).act(state([2]))


def test_an_object_that_hides_its_memory_is_refused() -> None:
    class Hidden:
        __slots__ = ("count",)

        def reset(self):
            self.count = 0

        def act(self, position):
            return position

    with pytest.raises(
        TypeError, match=r"function: expected an object with .* got Hidden with __s"
    ):
        FunctionController(Hidden)
