"""Checks of what controllers are fed with."""

from __future__ import annotations

from typing import Any

from torch import Tensor

__all__ = ["check_same_shape"]


def check_same_shape(owner: Any, position: Tensor, goal: Tensor, *parameters: Tensor) -> None:
    """Raise a ValueError unless position, goal and each parameter fit together."""
    if position.shape != goal.shape:
        raise ValueError(
            f"{type(owner).__name__}: position and goal must have one shape, "
            f"got {tuple(position.shape)} and {tuple(goal.shape)}."
        )
    for parameter in parameters:
        if parameter.ndim and parameter.shape[-1] != position.shape[-1]:
            raise ValueError(
                f"{type(owner).__name__}: one number for each of {position.shape[-1]} dimensions "
                f"was expected, got {parameter.shape[-1]}."
            )
