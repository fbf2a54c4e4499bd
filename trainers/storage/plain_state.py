"""State as plain, safe data: what is saved can be loaded without executing code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import NestedKey, TensorDictBase, is_leaf_nontensor
from torch import Tensor

_NUMPY = "__numpy__"


def to_plain(state: Any, path: str = "state") -> Any:
    """Return ``state`` made of tensors, numbers, text, lists, tuples and dictionaries alone.

    NumPy arrays and scalars are wrapped such that :func:`from_plain` gives them back.

    Args:
        state: What a component's ``state_dict`` returned.
        path: Where it stands, for the message.

    Raises:
        TypeError: If something in it cannot be saved; the message names it and says what to change.
    """
    if isinstance(state, Mapping):
        return {_key(k, path): to_plain(v, f"{path}[{k!r}]") for k, v in state.items()}
    if isinstance(state, (list, tuple)):
        items = [to_plain(item, f"{path}[{i}]") for i, item in enumerate(state)]
        return tuple(items) if isinstance(state, tuple) else items
    if isinstance(state, Tensor):
        return state.detach()
    if isinstance(state, (np.ndarray, np.generic)):
        array = np.asarray(state)
        if array.dtype.kind not in "biufc":
            raise _refused(path, f"a NumPy array of {array.dtype}")
        return {
            _NUMPY: torch.from_numpy(np.ascontiguousarray(array).view(np.uint8).reshape(-1).copy()),
            "dtype": array.dtype.str,
            "shape": list(array.shape),
            "scalar": isinstance(state, np.generic),
        }
    if state is None or isinstance(state, (bool, int, float, str, bytes, torch.Size)):
        return state
    raise _refused(path, f"a {type(state).__name__}")


def from_plain(state: Any) -> Any:
    """Undo :func:`to_plain`."""
    if isinstance(state, Mapping):
        if _NUMPY in state:
            raw = state[_NUMPY].numpy().view(np.dtype(state["dtype"])).reshape(state["shape"])
            return raw[()] if state["scalar"] else raw.copy()
        return {key: from_plain(value) for key, value in state.items()}
    if isinstance(state, (list, tuple)) and not isinstance(state, torch.Size):
        items: Sequence[Any] = [from_plain(item) for item in state]
        return tuple(items) if isinstance(state, tuple) else items
    return state


def entries(tensordict: TensorDictBase) -> dict[NestedKey, Any]:
    """Return a TensorDict's tensors and text with their keys, whatever characters these have."""
    found: dict[NestedKey, Any] = {}
    for key in tensordict.keys(True, True, is_leaf=is_leaf_nontensor):
        value = tensordict.get(key)
        if not isinstance(value, Tensor):  # text and other objects stand there as NonTensorData
            value = tensordict.get_non_tensor(key)
            if np.asarray(value).dtype.kind != "U":
                continue
        found[key] = value
    return found


def _key(key: Any, path: str) -> Any:
    if isinstance(key, (str, int, tuple)):
        return key
    raise _refused(path, f"a key of type {type(key).__name__}")


def _refused(path: str, what: str) -> TypeError:
    return TypeError(
        f"{path}: expected tensors, NumPy arrays, numbers, text, lists or dictionaries, "
        f"got {what}; let state_dict return it as such, or leave it out"
    )
