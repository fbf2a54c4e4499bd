"""What an object remembers, as plain data: what is saved is loaded without executing code.

Of NumPy's arrays and numbers that holds for a trainer's checkpoints; ``torch.load`` by itself reads
them with ``weights_only=False`` alone.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

_ATTRIBUTES, _DEQUE, _GENERATOR = "__attributes__", "__deque__", "__generator__"
_LEAVES = (type(None), bool, int, float, str, bytes, torch.Size)
_SHARED = (FunctionType, ModuleType, type, np.ufunc)
"""What copies share and nothing changes: left out while it is what was given."""


def remembered(name: str, thing: Any, given: Any) -> Any:
    """Return what an object remembers: what its ``state_dict()`` says, else its attributes.

    A torch module's ``state_dict()`` says weights and buffers; beside them it may hold a hidden
    state in an attribute. Of its attributes all that can be saved is.

    Args:
        name: What messages call it.
        thing: The object.
        given: What it is a copy of.

    Raises:
        TypeError: If something in it cannot be saved.
    """
    if _has_own_memory(thing):
        state = thing.state_dict()
        state = dict(state) if isinstance(state, Mapping) else state
        plain = _plain(state, f"controller {name}: state_dict()", "let state_dict() leave it out")
        if attributes := _attributes(thing):
            plain[_ATTRIBUTES] = attributes
        return plain
    remedy = "give it state_dict() and load_state_dict()"
    return {
        key: _plain(value, f"controller {name}: attribute {key}", remedy)
        for key, value in vars(thing).items()
        if not (isinstance(value, _SHARED) and value is vars(given).get(key))
    }


def remember(thing: Any, state: Any) -> None:
    """Give an object what :func:`remembered` returned."""
    restored = _restored(state)
    if _has_own_memory(thing):
        attributes = restored.pop(_ATTRIBUTES, {}) if isinstance(restored, dict) else {}
        thing.load_state_dict(restored)
        for path, values in attributes.items():
            for name, value in values.items():
                setattr(thing.get_submodule(path), name, value)
    elif isinstance(restored, Mapping):
        vars(thing).update(restored)


def check_memory(name: str, thing: Any) -> None:
    """Refuse an object whose attributes cannot be saved, unless it saves itself.

    Raises:
        TypeError: If one cannot be saved, or there are no attributes.
    """
    if _has_own_memory(thing):
        return
    if not hasattr(thing, "__dict__"):
        raise TypeError(
            f"function: expected an object with attributes or state_dict(), got {name} with "
            "__slots__; give it state_dict() and load_state_dict()"
        )
    remembered(name, thing, thing)


def _attributes(thing: Any) -> dict[str, dict[str, Any]]:
    """Return what a torch module holds beside its ``state_dict()``, by submodule and name."""
    if not isinstance(thing, nn.Module) or type(thing).state_dict is not nn.Module.state_dict:
        return {}
    saved, found = thing.state_dict(), dict[str, dict[str, Any]]()
    for path, module in thing.named_modules():
        if type(module).__module__.startswith("torch."):
            continue  # sizes and options
        values = {k: v for k, v in vars(module).items() if k not in vars(nn.Module())}
        for name, value in module.named_buffers(recurse=False):
            if f"{path}.{name}".lstrip(".") not in saved:
                values[name] = value
        for name, value in values.items():
            with suppress(TypeError):
                found.setdefault(path, {})[name] = _plain(value, name, "")
    return found


def _has_own_memory(thing: Any) -> bool:
    """Return whether an object saves and restores itself; one method alone does not do."""
    methods = ("state_dict", "load_state_dict")
    return all(callable(getattr(thing, name, None)) for name in methods)


def _plain(value: Any, place: str, remedy: str) -> Any:
    """Return a copy of tensors, arrays, numbers, text, lists, tuples and dictionaries alone.

    An error names the ``place`` and says what to do, the ``remedy``.
    """

    def items() -> list[Any]:
        return [_plain(item, f"{place}[{i}]", remedy) for i, item in enumerate(value)]

    kind = type(value)
    if isinstance(value, Tensor):
        return value.detach().clone()
    if kind in _LEAVES or (isinstance(value, np.generic) and value.dtype.kind in "biufc"):
        return value
    if kind is np.ndarray and value.dtype.kind in "biufc":
        return value.copy()
    if kind in (list, tuple):
        return kind(items())
    if kind is deque:
        return {_DEQUE: items(), "maxlen": value.maxlen}
    if kind is dict and all(type(key) in (str, int, tuple) for key in value):
        return {key: _plain(item, f"{place}[{key!r}]", remedy) for key, item in value.items()}
    if kind is np.random.Generator:
        bits = value.bit_generator
        if type(bits) is getattr(np.random, type(bits).__name__, None):
            state = _plain(dict(bits.state), place, remedy)
            return {_GENERATOR: type(bits).__name__, "state": state}
    of = f" of {value.dtype}" if isinstance(value, np.ndarray) else ""
    raise TypeError(
        f"{place}: expected tensors, NumPy arrays of numbers, numbers, text, lists, tuples, "
        f"dictionaries, deques or numpy.random.Generator, got a {kind.__name__}{of}; {remedy}"
    )


def _restored(value: Any) -> Any:
    """Undo :func:`_plain`."""
    if isinstance(value, Mapping):
        if _DEQUE in value:
            return deque(map(_restored, value[_DEQUE]), value["maxlen"])
        if _GENERATOR in value:
            bits = getattr(np.random, value[_GENERATOR])()
            bits.state = _restored(value["state"])
            return np.random.Generator(bits)
        return {key: _restored(item) for key, item in value.items()}
    if type(value) in (list, tuple):
        return type(value)(map(_restored, value))
    return copy.deepcopy(value)
