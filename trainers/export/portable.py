"""Operations that give the same with every runtime, on every machine.

A guard against commands that are not numbers has to see them. IEEE 754 defines comparisons with
NaN, while the maximum of a number and NaN depends on the runtime and the processor. And onnxruntime
does not choose between booleans.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

ATEN = torch.ops.aten
Bound = Tensor | float | None


def _at_least(x: Tensor, low: Any) -> Tensor:
    return _keep_nan(low, torch.where(x < low, low, x))


def _at_most(x: Tensor, high: Any) -> Tensor:
    return _keep_nan(high, torch.where(x > high, high, x))


def _keep_nan(bound: Any, x: Tensor) -> Tensor:
    return torch.where(bound != bound, bound, x) if isinstance(bound, Tensor) else x


def _clamp(x: Tensor, low: Bound = None, high: Bound = None) -> Any:
    if not x.is_floating_point():
        return NotImplemented
    x = x if low is None else _at_least(x, low)
    return x if high is None else _at_most(x, high)


def _relu(x: Tensor) -> Any:
    return _clamp(x, 0.0)


def _minimum(x: Tensor, other: Tensor) -> Any:
    return _clamp(x, None, other)


def _hardtanh(x: Tensor, low: float = -1.0, high: float = 1.0) -> Any:
    return _clamp(x, low, high)


def _where(mask: Tensor, x: Tensor, other: Tensor) -> Any:
    if x.dtype != torch.bool or other.dtype != torch.bool:
        return NotImplemented
    return (mask & x) | (~mask & other)


PORTABLE: dict[Any, Callable[..., Any]] = {
    ATEN.relu.default: _relu,
    ATEN.hardtanh.default: _hardtanh,
    ATEN.clamp.default: _clamp,
    ATEN.clamp.Tensor: _clamp,
    ATEN.clamp_min.default: _clamp,
    ATEN.clamp_min.Tensor: _clamp,
    ATEN.clamp_max.default: _minimum,
    ATEN.clamp_max.Tensor: _minimum,
    ATEN.maximum.default: _clamp,
    ATEN.minimum.default: _minimum,
    ATEN.where.self: _where,
}
"""Operation to what computes it from others; for numbers both give the same."""
