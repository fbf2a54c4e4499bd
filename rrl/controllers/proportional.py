"""The paper's hand-engineered controller."""

from __future__ import annotations

from collections.abc import Sequence

from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check_length, check_lengths, per_dimension
from rrl.controllers.base import Controller, clipped, floating
from rrl.keys import BASE_ACTION


class ProportionalController(Controller):
    """Proportional Cartesian control, u = clip(K (x_g - x) / unit) (section V: "P-controller").

    It reads the robot's own state and the goal only, nothing of the objects around.

    Args:
        position_key: Position x, ``[*batch, n]`` [m].
        goal_key: Goal x_g, ``[*batch, n]`` [m], in the same frame.
        gain: K, a number or one for each dimension; 1 commands the whole error in one step.
        clip: Largest magnitude of the action, a number or one for each dimension, positive; None:
            no clipping.
        unit: Length that one unit of the action stands for, positive [m].
        out_key: Where the action ``[*batch, n]`` goes.

    Raises:
        ValueError: If a gain is not finite, ``clip`` or ``unit`` is not positive; when run, if
            position, goal and parameters do not fit together.
        KeyError: When run, if position or goal is missing.
    """

    def __init__(
        self,
        position_key: NestedKey = "end_effector_position",
        goal_key: NestedKey = "goal",
        gain: float | Sequence[float] = 1.0,
        clip: float | Sequence[float] | None = 1.0,
        unit: float = 1.0,
        out_key: NestedKey = BASE_ACTION,
    ) -> None:
        super().__init__([position_key, goal_key], out_key)
        scale, factor = per_dimension("unit", unit, positive=True), per_dimension("gain", gain)
        check_lengths(gain=factor, unit=scale)
        self.register_buffer("_gain", factor / scale)
        limit = None if clip is None else per_dimension("clip", clip, positive=True)
        self.register_buffer("_clip", limit)

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the clipped proportional action ``[*batch, n]``."""
        error = self.error(tensordict)
        return clipped(error * self._gain.to(error.dtype), self._clip)

    def error(self, tensordict: TensorDictBase) -> Tensor:
        """Return x_g - x, ``[*batch, n]`` [m].

        Raises:
            ValueError: If position and goal have different shapes.
        """
        position, goal = (floating(self.read(tensordict, key)) for key in self.in_keys)
        if position.shape != goal.shape:
            raise ValueError(
                f"{self.in_keys[1]!r}: expected the shape of {self.in_keys[0]!r}, "
                f"{tuple(position.shape)}, got {tuple(goal.shape)}"
            )
        for name, value in self.named_buffers(recurse=False):
            check_length(
                name.strip("_"), value, position.shape[-1:].numel(), f"{self.in_keys[0]!r}"
            )
        return goal - position
