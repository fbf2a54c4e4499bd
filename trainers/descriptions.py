"""What a factory makes and was given, in plain JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from torch import Tensor

__all__ = ["named", "plain"]


def named(make: Any, *, modules: bool = True) -> dict[str, Any]:
    """Describe what a factory makes: its class or function, and the arguments given.

    Args:
        make: The factory; arguments without a name stand in their order under ``arguments``.
        modules: Whether names begin with the module, which differs between a script and its import.
    """
    if isinstance(make, partial):
        given = ({"arguments": make.args} if make.args else {}) | make.keywords
        return {**named(make.func, modules=modules), **plain(given, modules=modules)}
    name = getattr(make, "__qualname__", type(make).__qualname__)
    module = getattr(make, "__module__", type(make).__module__)
    return {"class": f"{module}.{name}" if modules else name}


def plain(value: Any, *, modules: bool = True) -> Any:
    """Return a value as JSON has it: what is not finite as null, objects by their names.

    A factory with arguments is described as :func:`named` does.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(entry, modules=modules) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry, modules=modules) for entry in value]
    if isinstance(value, (Tensor, np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, partial):
        return named(value, modules=modules)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if callable(value):
        return named(value, modules=modules)["class"]
    return repr(value) if modules else type(value).__qualname__
