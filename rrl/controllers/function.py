"""Anybody's function or object as the controller."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn

from rrl.controllers.base import State, StatefulController
from rrl.controllers.plain_memory import check_memory, remember, remembered
from rrl.keys import BASE_ACTION


class FunctionController(StatefulController):
    """A function of observations, or an object that remembers, as the controller.

    A function is called once for each slot with the values of ``in_keys``, without batch
    dimensions. An object that has ``reset()`` has a memory: every slot gets a copy of its own,
    whose ``reset()`` is called when an episode starts. Its memory is part of ``state_dict``: what
    its own ``state_dict()`` says, which ``load_state_dict()`` takes back, else its attributes; of a
    ``torch.nn.Module`` both. Attributes may be tensors, arrays, numbers, text, lists, tuples,
    dictionaries, deques and ``numpy.random.Generator``. No gradient passes it, and one that
    remembers is called without (``torch.no_grad``).

    Args:
        function: A callable, or an object with ``act``; a class, or a partial of one, is called
            without arguments first, so that a configuration can name it.
        in_keys: Observation keys, whose values become its arguments, in this order.
        batched: Call it once with all slots, values ``[*batch, ...]``; only without memory.
        numpy: Give it NumPy arrays, not tensors; None: unless it is a ``torch.nn.Module``.
        out_key: Where the action ``[*batch, n_act]`` goes.

    Raises:
        TypeError: If ``function`` cannot be called, or has a memory that it does not show or that
            cannot be saved; when run, if what it returns is no array of numbers.
        ValueError: If ``batched`` is asked for an object with a memory; when run, if what it
            returns is not one action a slot.
        Exception: When run, what ``function`` raises, with its name in front.
    """

    def __init__(
        self,
        function: Callable[..., Any] | Any,
        in_keys: Sequence[NestedKey] = ("observation",),
        *,
        batched: bool = False,
        numpy: bool | None = None,
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
        if self.remembers:
            check_memory(_name(function), function)
        self._function, self._batched = function, batched
        self._numpy = not isinstance(function, nn.Module) if numpy is None else numpy
        self._slots: list[Any] = []  # copies of the object, one a slot, flattened

    @property
    def outside_torch(self) -> str | None:
        """What keeps it from being recorded as a graph; None: nothing that is known."""
        if self.remembers:
            return "remembers outside torch"
        return "calls NumPy" if self._numpy else None

    def called(self) -> str:
        """Return the name of the function or of the object's class."""
        return _name(self._function)

    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Return nothing: the objects hold their memory themselves."""
        return {}

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the action ``[*batch, n_act]``.

        Raises:
            ValueError: If the function gives an action of another shape.
        """
        values = [self.read(tensordict, key) for key in self.in_keys]
        batch = tensordict.batch_size
        if self._batched:
            return self._call(self._function, values)
        flat = [value.reshape(batch.numel(), *value.shape[len(batch) :]) for value in values]
        unused = self.remembers and len(self._slots) != batch.numel()
        rows = [
            self._call(function, [value[i] for value in flat])
            for i, function in enumerate(self._functions(batch))
        ]
        if unused:  # what it remembers shows when it has acted
            self.get_extra_state()
        shapes = {tuple(row.shape): None for row in rows}
        if () in shapes or len(shapes) > 1:
            got = " and ".join(map(str, shapes))
            raise ValueError(f"{self.called()}: expected an action of shape [n_act], got {got}")
        action = torch.stack(rows)
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
        name, given = self.called(), self._function
        slots = [remembered(name, slot, given) for slot in self._slots]
        return {"slots": slots, "fresh": self._fresh}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take what the objects remember from a ``state_dict``."""
        self._slots = self._copies(len(state["slots"]))
        for slot, memory in zip(self._slots, state["slots"], strict=True):
            remember(slot, memory)
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
            self._slots = self._copies(batch.numel())
            fresh = torch.ones(batch, dtype=torch.bool)
        if fresh is not None:
            for i in fresh.flatten().nonzero().flatten().tolist():
                try:
                    self._slots[i].reset()
                except Exception as error:
                    _raise_named(self.called(), error)
            self._fresh = None
        return self._slots

    def _copies(self, number: int) -> list[Any]:
        try:
            return [copy.deepcopy(self._function) for _ in range(number)]
        except TypeError as error:
            raise TypeError(
                f"controller {self.called()}: expected an object that can be copied, one for each "
                f"slot, got one of which Python says: {error}; give it __deepcopy__()"
            ) from error

    def _call(self, function: Any, values: Sequence[Tensor]) -> Tensor:
        given = [_array(value) if self._numpy else value for value in values]
        try:
            # What it remembers is copied, and must not hold on to all steps before.
            with torch.set_grad_enabled(torch.is_grad_enabled() and not self.remembers):
                said = getattr(function, "act", function)(*given)
        except Exception as error:
            _raise_named(self.called(), error)
        try:
            action = torch.as_tensor(said).detach()
        except (TypeError, ValueError, RuntimeError) as error:
            shape = "[*batch, n_act]" if self._batched else "[n_act]"
            raise TypeError(
                f"{self.called()}: expected an action of shape {shape}, got {_described(said)}"
            ) from error
        return action.to(values[0].device) if values else action


def _array(value: Tensor) -> Any:
    value = value.detach().cpu()
    if value.dtype == torch.bfloat16:  # unknown to NumPy
        value = value.float()
    return value.numpy()


def _name(function: Any) -> str:
    """Return what messages call a function or an object."""
    if isinstance(function, partial):
        return _name(function.func)
    if inspect.ismethod(function):
        return f"{type(function.__self__).__name__}.{function.__name__}"
    name = getattr(function, "__name__", type(function).__name__)
    if name == "<lambda>":
        code = function.__code__
        return f"the lambda in {Path(code.co_filename).name}:{code.co_firstlineno}"
    return name


def _described(said: Any) -> str:
    """Return what a function said where an action was expected."""
    if said is None or isinstance(said, str):
        return repr(said)
    if isinstance(said, (tuple, list)):
        inside = ", ".join(type(item).__name__ for item in said)
        return f"a {type(said).__name__} of {inside or 'nothing'}"
    return f"a {type(said).__name__}"


def _raise_named(name: str, error: Exception) -> NoReturn:
    """Raise an error again with a controller's name; as a RuntimeError if its text is not its own.

    Raises:
        Exception: Always.
    """
    kind = "" if str(error) and not isinstance(error, KeyError) else f"{type(error).__name__}: "
    text = f"controller {name}: {kind}{error}".removesuffix(": ")
    if all(isinstance(argument, str) for argument in error.args) and len(error.args) < 2:
        before, error.args = error.args, (text,)
        if name in str(error):
            raise error
        error.args = before
    raise RuntimeError(text) from error
