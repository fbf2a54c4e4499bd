"""The paper's hand-engineered controller."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import per_dimension
from rrl.controllers._checks import check_same_shape
from rrl.controllers.base import Controller
from rrl.keys import BASE_ACTION

__all__ = ["ProportionalController"]


class ProportionalController(Controller):
    """Proportional Cartesian control, u = clip(K (x_g - x) / unit) (section V: "P-controller").

    It reads the robot's own state and the goal only, nothing of the objects around.

    Args:
        position_key: Position x, ``[*batch, n]`` in metres.
        goal_key: Goal x_g, ``[*batch, n]`` in metres, same frame.
        gain: K, a number or one a dimension; 1 commands the whole error in one step.
        clip: Largest magnitude of the action, a number or one a dimension, positive; None: no
            clipping.
        unit: Metres that one unit of the action stands for.
        out_key: Where the action ``[*batch, n]`` goes.

    Raises:
        ValueError: If a gain is not finite, or ``clip`` or ``unit`` is not positive.
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
        self.position_key = position_key
        self.goal_key = goal_key
        scale = per_dimension("unit", unit, positive=True)
        self.register_buffer("_gain", per_dimension("gain", gain) / scale)
        limit = None if clip is None else per_dimension("clip", clip, positive=True)
        self.register_buffer("_high", limit)
        self.register_buffer("_low", None if limit is None else -limit)

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the clipped proportional action ``[*batch, n]``."""
        position = self.read(tensordict, self.position_key)
        goal = self.read(tensordict, self.goal_key)
        gain, low, high = self._gain, self._low, self._high
        check_same_shape(self, position, goal, gain, gain if high is None else high)
        action = (goal - position) * gain
        return action if high is None else torch.clamp(action, low, high)
