"""Anybody's function or object as the controller: arrays and tensors, memory slot by slot."""

from __future__ import annotations

import copy
import threading
from functools import partial

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.data import Bounded
from torchrl.envs import SerialEnv, TransformedEnv

from rrl.controllers import FunctionController
from rrl.transforms import ResidualAction
from situation_envs import Machine
from toy_envs import PointMass

KEYS = ["end_effector_position", "goal"]
BATCHES = ([], [1], [3], [2, 3])


def towards(position, goal):
    """What most people would write: it takes one environment's numbers."""
    assert position.shape == goal.shape == (2,)
    return 0.5 * (goal - position)


def arrays(position, goal):
    assert isinstance(position, np.ndarray)
    return towards(position, goal)


def tensors(position, goal):
    assert isinstance(position, torch.Tensor)
    return towards(position, goal)


def branches(position, goal):
    """Cannot take a batch: it decides by one number, and returns a list."""
    return [1.0, 0.0] if position[0] < goal[0] else [-1.0, 0.0]


class Counter:
    """Remembers how often it acted in the episode."""

    def __init__(self, start=0):
        self.start, self.resets = start, 0

    def reset(self):
        self.count = self.start
        self.resets += 1

    def act(self, position):
        self.count += 1
        return np.array([self.count, self.resets])


def state(batch) -> TensorDict:
    values = {key: torch.rand(*batch, 2) for key in KEYS}
    return TensorDict(values, batch_size=batch)


@pytest.mark.parametrize("batch", BATCHES, ids=str)
@pytest.mark.parametrize(("function", "numpy"), [(arrays, True), (tensors, False)])
def test_row_by_row(batch, function, numpy) -> None:
    data = state(batch)
    out = FunctionController(function, KEYS, numpy=numpy)(data)["base_action"]
    assert torch.equal(out, 0.5 * (data["goal"] - data["end_effector_position"]))


@pytest.mark.parametrize("batch", BATCHES, ids=str)
def test_all_slots_in_one_call(batch) -> None:
    calls, data = [], state(batch)

    def function(position, goal):
        calls.append(position.shape)
        return goal - position

    out = FunctionController(function, KEYS, batched=True)(data)["base_action"]
    assert torch.equal(out, data["goal"] - data["end_effector_position"])
    assert calls == [(*batch, 2)]


def test_where_a_batch_is_not_taken() -> None:
    data = state([4])
    with pytest.raises(ValueError, match="ambiguous"):
        FunctionController(branches, KEYS, batched=True)(data)
    right = data["end_effector_position"][:, 0] < data["goal"][:, 0]
    out = FunctionController(branches, KEYS)(data)["base_action"]
    assert torch.equal(out[:, 0], torch.where(right, 1.0, -1.0))


@pytest.mark.parametrize("numpy", [True, False])
@pytest.mark.parametrize("batched", [True, False])
def test_a_function_that_writes_into_its_arguments_changes_nothing_else(numpy, batched) -> None:
    def careless(position):
        position += 1.0
        return position

    data = state([2])
    before = data.clone()
    out = FunctionController(careless, KEYS[:1], batched=batched, numpy=numpy).act(data)
    assert torch.equal(out, before[KEYS[0]] + 1.0)
    assert torch.equal(data[KEYS[0]], before[KEYS[0]])


def test_a_module_is_a_function_too() -> None:
    module, data = nn.Linear(2, 2), state([3])
    controller = FunctionController(module, KEYS[:1], batched=True, numpy=False)
    assert torch.equal(controller.act(data), module(data[KEYS[0]]))


@pytest.mark.parametrize(
    "controller",
    [Counter, partial(Counter, start=0), Counter()],
    ids=["class", "partial", "object"],
)
def test_every_slot_has_a_memory_of_its_own(controller) -> None:
    controller, data = FunctionController(controller, KEYS[:1]), state([3])
    assert controller.act(data).tolist() == [[1, 1]] * 3
    controller.reset(torch.tensor([False, True, False]))
    assert controller.act(data).tolist() == [[2, 1], [1, 2], [2, 1]]
    controller.reset()
    assert controller.act(data).tolist() == [[1, 1]] * 3
    assert controller.act(state([])).tolist() == [1, 1]  # another batch is another start


def test_the_object_that_was_given_stays_as_it_is() -> None:
    given = Counter()
    FunctionController(given, KEYS[:1]).act(state([2]))
    assert given.resets == 0
    assert not hasattr(given, "count")


def test_memory_in_episodes_that_end_apart() -> None:
    lengths = (3, 5)
    base = SerialEnv(2, [partial(PointMass, seed=n, episode_steps=n) for n in lengths])
    controller = FunctionController(Counter, KEYS[:1])
    env = TransformedEnv(base, ResidualAction(controller, scale=0.0))
    tensordict, counted = env.reset(), []
    for _ in range(7):
        counted.append(tensordict["base_action"][:, 0].tolist())
        _, tensordict = env.step_and_maybe_reset(env.rand_action(tensordict))
    assert counted == [[1, 1], [2, 2], [3, 3], [1, 4], [2, 5], [3, 1], [1, 2]]


def test_memory_is_put_back_slot_by_slot() -> None:
    controller, data = FunctionController(Counter, KEYS[:1]), state([2])
    start = controller.memory()
    controller.act(data)
    before = controller.memory()
    controller.act(data)
    controller.put_back(before, torch.tensor([True, False]))
    assert controller.act(data).tolist() == [[2, 1], [3, 1]]
    controller.put_back(start, torch.tensor([True, False]))
    assert controller.act(data)[:, 0].tolist() == [1, 4]


class WithStateDict(Counter):
    def state_dict(self):
        return {"count": self.count}

    def load_state_dict(self, saved):
        self.count, self.resets = saved["count"], 10


@pytest.mark.parametrize(("kind", "resets"), [(Counter, 1), (WithStateDict, 10)])
def test_memory_is_part_of_state_dict(kind, resets) -> None:
    controller, data = FunctionController(kind, KEYS[:1]), state([2])
    controller.act(data)
    controller.act(data)
    controller.reset(torch.tensor([False, True]))  # still to come when it is saved
    saved, other = controller.state_dict(), FunctionController(kind, KEYS[:1])
    controller.act(data)
    other.load_state_dict(saved)
    assert other.act(data).tolist() == [[3, resets], [1, resets + 1]]


@pytest.mark.parametrize("batch", [[], [2]], ids=str)
def test_double_precision(batch) -> None:
    """What the function computes arrives unrounded where the environment's action is double."""
    third = np.full(2, 1 / 3)
    controller = FunctionController(lambda position: third, ["position"])
    actions = {torch.float32: torch.full((*batch, 2), 1 / 3)}
    actions[torch.float64] = torch.tensor(third).expand(*batch, 2)
    for dtype, expected in actions.items():
        base = Machine(action=Bounded(-1.0, 1.0, (2,), dtype=dtype), batch_size=batch)
        env = TransformedEnv(base, ResidualAction(controller, scale=0.0))
        sent = env.rollout(2)["base_action"]
        assert sent.dtype == dtype
        assert torch.equal(sent[..., 0, :], expected)


@pytest.mark.parametrize("batch", [[], [3]], ids=str)
def test_it_solves_what_the_function_solves(batch) -> None:
    """In an environment, with a zero residual: the drift is known to the function."""

    def solve(position, goal):
        return np.clip((goal - position) / 0.1 - [0.6, 0.0], -1.0, 1.0)

    base = PointMass(batch, episode_steps=40)
    env = TransformedEnv(base, ResidualAction(FunctionController(solve, KEYS)))
    rollout = env.rollout(40, lambda td: td.set("action", torch.zeros(*batch, 2)))
    assert rollout["next", "success"][..., -1, :].all()


def test_what_is_not_callable() -> None:
    with pytest.raises(TypeError, match=r"expected a callable or an object with act\(\), got a i"):
        FunctionController(3)


def test_a_memory_in_one_call() -> None:
    with pytest.raises(ValueError, match="batched: expected a function without memory"):
        FunctionController(Counter, batched=True)


def test_no_gradient_passes() -> None:
    controller = FunctionController(nn.Linear(2, 2), KEYS[:1], batched=True, numpy=False)
    assert not controller.act(state([2])).requires_grad


def test_missing_key_is_named() -> None:
    with pytest.raises(KeyError, match=r"towards: expected .*'observation'.*goal"):
        FunctionController(towards).act(state([2]))


@pytest.mark.parametrize("batched", [False, True])
def test_values_that_no_array_holds_as_they_are(batched) -> None:
    position = torch.ones(2, 2, dtype=torch.bfloat16, requires_grad=True)
    controller = FunctionController(lambda x: 0.5 * x, ["x"], batched=batched)
    assert controller.act(TensorDict({"x": position}, [2])).tolist() == [[0.5, 0.5]] * 2


class Guarded:
    """Holds what cannot be copied, as a simulator or a connection."""

    def __init__(self):
        self.lock = threading.Lock()

    def __call__(self, position, goal):
        with self.lock:
            return towards(position, goal)


@pytest.mark.parametrize("how", [lambda guarded: guarded, lambda guarded: guarded.__call__])
def test_a_function_that_cannot_be_copied_is_shared_by_copies(how) -> None:
    controller = FunctionController(how(Guarded()), KEYS)
    env = TransformedEnv(PointMass(batch_size=[2]), ResidualAction(controller, 0.5))
    twin = copy.deepcopy(controller)
    given = state([2])
    torch.testing.assert_close(twin(given.clone()), controller(given.clone()))
    env.rollout(3)
    env.transform.clone()


def test_copies_share_no_memory() -> None:
    controller = FunctionController(Counter(), ["position"])
    for _ in range(2):
        controller(TensorDict({"position": torch.zeros(1, 1)}, [1]))
    twin = copy.deepcopy(controller)
    for each, count in ((twin, 3), (controller, 3), (twin, 4)):
        action = each(TensorDict({"position": torch.zeros(1, 1)}, [1]))["base_action"]
        assert action.tolist() == [[count, 1]]


class SavesButDoesNotLoad(Counter):
    def state_dict(self):
        return {"sum": self.count}


def test_one_half_of_a_memory_of_its_own_is_none() -> None:
    controller, data = FunctionController(SavesButDoesNotLoad, KEYS[:1]), state([2])
    controller.act(data)
    other = FunctionController(SavesButDoesNotLoad, KEYS[:1])
    other.load_state_dict(controller.state_dict())
    assert other.act(data).tolist() == controller.act(data).tolist()
