"""Checks of parameters, keys and shapes. Every message reads ``name: expected X, got Y``."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import Composite

from rrl.keys import INTERVENTION, SAFETY, SO_FAR

_OWN = (SAFETY, SO_FAR, INTERVENTION, "_given")
"""Groups of entries that transforms of this package write."""


def check(name: str, value: object, expected: str, fine: bool) -> None:
    """Raise a ValueError that names a parameter, unless it is fine.

    Raises:
        ValueError: If it is not.
    """
    if not fine:
        raise ValueError(f"{name}: expected {expected}, got {value!r}")


def check_whole(name: str, value: float, minimum: int) -> int:
    """Return ``value`` as an integer.

    Raises:
        ValueError: If it is not a whole number of at least ``minimum``.
    """
    known = isinstance(value, Real) and minimum <= value < float("inf")
    fine = known and value == int(value)
    check(name, value, f"a whole number of at least {minimum}", fine)
    return int(value)


def check_sizes(name: str, values: object) -> None:
    """Raise a ValueError unless ``values`` is a list of whole numbers above 0."""
    listed = isinstance(values, Sequence) and not isinstance(values, str)
    fine = listed and all(isinstance(n, int) and n > 0 for n in values)  # type: ignore[attr-defined]
    check(name, values, "a list of whole numbers above 0", fine)


def check_share(name: str, value: float, *, below_one: bool = False) -> float:
    """Return a share or a probability.

    Raises:
        ValueError: If it is no number in [0, 1], or [0, 1) with ``below_one``.
    """
    fine = isinstance(value, Real) and 0 <= value <= 1 and not (below_one and value == 1)
    check(name, value, "a number in [0, 1)" if below_one else "a number in [0, 1]", fine)
    return float(value)


def per_dimension(
    name: str,
    value: float | Sequence[float] | Tensor,
    *,
    minimum: float | None = None,
    positive: bool = False,
) -> Tensor:
    """Return a number, or one number for each dimension, as a float64 tensor ``[]`` or ``[n]``.

    Raises:
        ValueError: If it is neither, not finite, below the minimum, or not positive but must be.
    """
    try:
        tensor = torch.as_tensor(value, dtype=torch.float64).detach().clone()
    except (TypeError, ValueError, RuntimeError):
        tensor = torch.empty(0)
    one_or_list = tensor.ndim <= 1 and tensor.numel() > 0
    check(name, value, "a number or a list with one number for each dimension", one_or_list)
    check(name, value, "finite numbers", bool(tensor.isfinite().all()))
    if minimum is not None:
        check(name, value, f"numbers of at least {minimum:g}", bool((tensor >= minimum).all()))
    check(name, value, "positive numbers", not positive or bool((tensor > 0).all()))
    return tensor


def check_length(name: str, value: Tensor, size: int, what: str) -> None:
    """Raise a ValueError unless ``value`` is one number or has one for each dimension.

    Raises:
        ValueError: If it has another length.
    """
    if value.ndim and value.shape[-1] != size:
        raise ValueError(
            f"{name}: expected one number or {size}, as many as {what} has dimensions, "
            f"got {value.shape[-1]}"
        )


def check_lengths(**values: Tensor) -> None:
    """Raise a ValueError unless all lists among the values have the same length."""
    first, *others = [name for name, value in values.items() if value.ndim] or [""]
    for name in others:
        check_length(name, values[name], len(values[first]), first)


def check_keys(owner: Any, in_keys: Sequence[NestedKey], out_keys: Sequence[NestedKey]) -> None:
    """Raise a ValueError unless there is one out key for each of at least one in key.

    Raises:
        ValueError: If there are more or fewer.
    """
    if not in_keys or len(in_keys) != len(out_keys):
        raise ValueError(
            f"{type(owner).__name__}: expected at least one in key and one out key for each, got "
            f"{list(in_keys)} and {list(out_keys)}"
        )


def missing(owner: Any, method: str) -> NotImplementedError:
    """Return the error of a class without a method that its base asks for."""
    return NotImplementedError(
        f"{type(owner).__name__}: expected a method {method}(), got none; its base class says what "
        "it returns"
    )


def require(
    owner: Any,
    entries: TensorDictBase | Composite,
    key: NestedKey,
    remedy: str = "",
    *,
    group: bool = False,
) -> Any:
    """Return an entry of a TensorDict, or the spec of one.

    Raises:
        KeyError: If there is no such entry; the message says who needs it and what there is, but
            for what this package writes for itself.
        TypeError: If it is a group of entries, unless ``group`` says that it may be one.
    """
    value, root = entries.get(key, None), _root(key)
    name = owner if isinstance(owner, str) else type(owner).__name__
    if value is None:
        present = [k for k in _sorted(entries) if _root(k) not in _OWN or _root(k) == root]
        raise KeyError(f"{name}: expected the entry {key!r}, got {present}{remedy}")
    if not group and isinstance(value, (TensorDictBase, Composite)):
        inside = [unravel_key((key, k)) for k in _sorted(value)]
        raise TypeError(
            f"{name}: expected the entry {key!r} to be a tensor, got a group with {inside}"
        )
    return value


def _sorted(entries: TensorDictBase | Composite) -> list[NestedKey]:
    return sorted(entries.keys(True, True), key=str)


def _root(key: NestedKey) -> str:
    return key if isinstance(key, str) else key[0]
