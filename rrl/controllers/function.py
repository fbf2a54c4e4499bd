"""Anybody's function or object as the controller."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn

from rrl.controllers.base import State, StatefulController
from rrl.keys import BASE_ACTION

__all__ = ["FunctionController"]


class FunctionController(StatefulController):
    """A function of observations, or an object that remembers, as the controller.

    A function is called once for each slot with the values of ``in_keys``, without batch
    dimensions. An object that has ``reset()`` has a memory: every slot gets a copy of its own,
    whose ``reset()`` is called when an episode starts. Its memory is part of ``state_dict``: what
    its own ``state_dict()`` says, else its attributes.

    Args:
        function: A callable, or an object with ``act``; a class, or a partial of one, is called
            without arguments first, so that a configuration can name it.
        in_keys: Observation keys, whose values become its arguments, in this order.
        batched: Call it once with all slots, values ``[*batch, ...]``; only without memory.
        numpy: Give it NumPy arrays, not tensors.
        out_key: Where the action ``[*batch, n_act]`` goes.

    Raises:
        TypeError: If ``function`` cannot be called, or has a memory that it does not show.
        ValueError: If ``batched`` is asked for an object with a memory; when run, if what it
            returns is not one action a slot.
    """

    def __init__(
        self,
        function: Callable[..., Any] | Any,
        in_keys: Sequence[NestedKey] = ("observation",),
        *,
        batched: bool = False,
        numpy: bool = True,
        out_key: NestedKey = BASE_ACTION,
    ) -> None:
        super().__init__(in_keys, out_key)
        if isinstance(function.func if isinstance(function, partial) else function, type):
            function = function()
        if not callable(getattr(function, "act", function)):
            raise TypeError(
                "function: expected a callable or an object with act(), "
                f"got a {type(function).__name__}"
            )
        self.remembers = callable(getattr(function, "reset", None))
        if batched and self.remembers:
            raise ValueError(
                "batched: expected a function without memory, got an object with reset(), which "
                "every slot needs a copy of"
            )
        keeps_attributes = hasattr(function, "__dict__") or hasattr(function, "state_dict")
        if self.remembers and not keeps_attributes:
            raise TypeError(
                "function: expected an object with attributes or state_dict(), got "
                f"{_name(function)} with __slots__; give it state_dict() and load_state_dict()"
            )
        self._function, self._batched, self._numpy = function, batched, numpy
        self._slots: list[Any] = []  # copies of the object, one a slot, flattened

    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Return nothing: the objects hold their memory themselves."""
        return {}

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the action ``[*batch, n_act]``."""
        values = [self.read(tensordict, key) for key in self.in_keys]
        batch = tensordict.batch_size
        if self._batched:
            return self._call(self._function, values)
        flat = [value.reshape(batch.numel(), *value.shape[len(batch) :]) for value in values]
        rows = [
            self._call(function, [value[i] for value in flat])
            for i, function in enumerate(self._functions(batch))
        ]
        action = torch.stack(rows)
        if action.ndim < 2:
            raise ValueError(
                f"{_name(self._function)}: expected an action of shape [n_act], "
                f"got {tuple(action.shape[1:])}"
            )
        return action.reshape(batch + action.shape[1:])

    def reset_state(self, mask: Tensor | None) -> None:
        """Have the slots where ``mask`` is True reset before they act next; None: all."""
        if mask is None or not self._slots:
            self._slots, self._fresh = [], None
        else:
            self._fresh = mask if self._fresh is None else self._fresh | mask

    def memory(self) -> Any:
        """Return copies of the objects."""
        return copy.deepcopy(self._slots), self._fresh

    def put_back(self, memory: Any, mask: Tensor) -> None:
        """Put copies of the objects back in the slots where ``mask`` is True."""
        slots, fresh = memory
        if not slots:
            self.reset_state(mask)
            return
        for i in mask.flatten().nonzero().flatten().tolist():
            self._slots[i] = slots[i]
        if fresh is not None:
            old = torch.zeros_like(mask) if self._fresh is None else self._fresh
            self._fresh = torch.where(mask, fresh, old)

    def get_extra_state(self) -> dict[str, Any]:
        """Return what the objects remember."""
        return {"slots": [_remembered(slot) for slot in self._slots], "fresh": self._fresh}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take what the objects remember from a ``state_dict``."""
        self._slots = [copy.deepcopy(self._function) for _ in state["slots"]]
        for slot, remembered in zip(self._slots, state["slots"], strict=True):
            _remember(slot, remembered)
        self._fresh = state["fresh"]

    def __deepcopy__(self, memo: dict[int, Any]) -> FunctionController:
        # The function is called, or copied for a slot, and never changed: a copy may share it. It
        # may hold what cannot be copied: a simulator, a connection, a lock.
        if not isinstance(self._function, nn.Module):
            memo[id(self._function)] = self._function
        twin = memo[id(self)] = self.__class__.__new__(self.__class__)
        twin.__dict__.update(copy.deepcopy(self.__dict__, memo))
        return twin

    def _functions(self, batch: torch.Size) -> Sequence[Any]:
        """Return every slot's callable, of an episode that has begun."""
        if not self.remembers:
            return [self._function] * batch.numel()
        fresh = self._fresh
        if len(self._slots) != batch.numel():
            self._slots = [copy.deepcopy(self._function) for _ in range(batch.numel())]
            fresh = torch.ones(batch, dtype=torch.bool)
        if fresh is not None:
            for i in fresh.flatten().nonzero().flatten().tolist():
                self._slots[i].reset()
            self._fresh = None
        return self._slots

    def _call(self, function: Any, values: Sequence[Tensor]) -> Tensor:
        # Copies: some functions write into their arguments.
        given = [_array(value) if self._numpy else value.clone() for value in values]
        action = torch.as_tensor(getattr(function, "act", function)(*given))
        return action.to(values[0].device) if values else action


def _array(value: Tensor) -> Any:
    value = value.detach().cpu()
    if value.dtype == torch.bfloat16:  # unknown to NumPy
        value = value.float()
    return value.numpy().copy()


def _name(function: Any) -> str:
    return getattr(function, "__name__", type(function).__name__)


def _has_own_memory(slot: Any) -> bool:
    """Return whether an object saves and restores itself; one method alone does not do."""
    methods = ("state_dict", "load_state_dict")
    return all(callable(getattr(slot, name, None)) for name in methods)


def _remembered(slot: Any) -> Any:
    return slot.state_dict() if _has_own_memory(slot) else copy.deepcopy(vars(slot))


def _remember(slot: Any, remembered: Any) -> None:
    if _has_own_memory(slot):
        slot.load_state_dict(remembered)
    elif isinstance(remembered, Mapping):
        vars(slot).update(copy.deepcopy(dict(remembered)))
