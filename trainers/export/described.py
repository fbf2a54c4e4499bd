"""What a contract says about the chain, in plain JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from torch import Tensor
from torchrl.data import TensorSpec

from rrl.transforms.base import RandomTransform
from rrl.transforms.base.action_bounds import limits_of

from ..environment import EnvironmentFactory

__all__ = ["array", "bounds", "left_out", "named", "plain"]


def array(name: str, value: Tensor, unit: str | None = None, **more: Any) -> dict[str, Any]:
    """Describe an array that goes into the graph or comes out of it."""
    node = {"name": name, "shape": list(value.shape), "dtype": str(value.dtype).split(".")[-1]}
    return {**node, **({"unit": unit} if unit else {}), **more}


def bounds(action: TensorSpec) -> dict[str, Any]:
    """Describe an action's bounds, one number for each dimension; null: there is none."""
    limits = limits_of(action)
    return {side: plain(getattr(limits, side).flatten().tolist()) for side in ("low", "high")}


def named(make: Any) -> dict[str, Any]:
    """Describe what a factory makes: its class or function, and the arguments given.

    Those without a name stand in their order under ``arguments``.
    """
    if isinstance(make, partial):
        unnamed = {"arguments": plain(make.args)} if make.args else {}
        return {**named(make.func), **unnamed, **plain(make.keywords)}
    name = getattr(make, "__qualname__", type(make).__qualname__)
    return {"class": f"{getattr(make, '__module__', type(make).__module__)}.{name}"}


def left_out(environment: EnvironmentFactory) -> dict[str, list[dict[str, Any]]]:
    """Describe what simulates a fault and is not exported."""
    faults = [make for make in environment.sensing if isinstance(make(), RandomTransform)]
    return {
        "disturbances": [named(make) for make in environment.disturbances],
        "sensing": [named(make) for make in faults],
    }


def plain(value: Any) -> Any:
    """Return a value as JSON has it: what is not finite as null, objects by their names.

    A factory with arguments is described as :func:`named` does.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, (Tensor, np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, partial):
        return named(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    return named(value)["class"] if callable(value) else repr(value)
