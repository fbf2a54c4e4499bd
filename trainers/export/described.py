"""What a contract says about the chain, in plain JSON."""

from __future__ import annotations

from typing import Any

from torch import Tensor
from torchrl.data import TensorSpec

from rrl.transforms.base import RandomTransform
from rrl.transforms.base.action_bounds import limits_of

from ..descriptions import named, plain
from ..environment import EnvironmentFactory

__all__ = ["array", "bounds", "left_out"]


def array(name: str, value: Tensor, unit: str | None = None, **more: Any) -> dict[str, Any]:
    """Describe an array that goes into the graph or comes out of it."""
    node = {"name": name, "shape": list(value.shape), "dtype": str(value.dtype).split(".")[-1]}
    return {**node, **({"unit": unit} if unit else {}), **more}


def bounds(action: TensorSpec) -> dict[str, Any]:
    """Describe an action's bounds, one number for each dimension; null: there is none."""
    limits = limits_of(action)
    return {side: plain(getattr(limits, side).flatten().tolist()) for side in ("low", "high")}


def left_out(environment: EnvironmentFactory) -> dict[str, list[dict[str, Any]]]:
    """Describe what simulates a fault and is not exported."""
    faults = [make for make in environment.sensing if isinstance(make(), RandomTransform)]
    return {
        "disturbances": [named(make) for make in environment.disturbances],
        "sensing": [named(make) for make in faults],
    }
