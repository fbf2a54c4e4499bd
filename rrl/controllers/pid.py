"""A controller with memory: proportional, integral and derivative action."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import per_dimension
from rrl.controllers._checks import check_same_shape
from rrl.controllers.base import State, StatefulController
from rrl.keys import BASE_ACTION

__all__ = ["PIDController"]


class PIDController(StatefulController):
    """Cartesian PID control.

    With the error e = x_g - x the action is

        u = clip((K e + K_i sum(e) dt + K_d (e_t - e_{t-1}) / dt) / unit).

    In an episode's first step the derivative is zero. The integral stands still in a dimension
    whose action is clipped and would be driven further out (anti-windup by conditional
    integration).

    Args:
        position_key: Position x, ``[*batch, n]`` in metres.
        goal_key: Goal x_g, ``[*batch, n]`` in metres, same frame.
        gain: K, a number or one a dimension.
        integral_gain: K_i in 1/s, a number or one a dimension.
        derivative_gain: K_d in s, a number or one a dimension.
        time_step: dt, the control step in seconds, positive.
        clip: Largest magnitude of the action, a number or one a dimension, positive; None: no
            clipping.
        unit: Metres that one unit of the action stands for.
        out_key: Where the action ``[*batch, n]`` goes.

    Raises:
        ValueError: If a gain is not finite, or ``clip``, ``unit`` or ``time_step`` is not positive.
        KeyError: When run, if position or goal is missing.

    """

    def __init__(
        self,
        position_key: NestedKey = "end_effector_position",
        goal_key: NestedKey = "goal",
        gain: float | Sequence[float] = 1.0,
        integral_gain: float | Sequence[float] = 0.0,
        derivative_gain: float | Sequence[float] = 0.0,
        time_step: float = 0.05,
        clip: float | Sequence[float] | None = 1.0,
        unit: float = 1.0,
        out_key: NestedKey = BASE_ACTION,
    ) -> None:
        super().__init__([position_key, goal_key], out_key)
        self.position_key = position_key
        self.goal_key = goal_key
        scale = per_dimension("unit", unit, positive=True)
        step = per_dimension("time_step", time_step, positive=True)
        self.register_buffer("_gain", per_dimension("gain", gain) / scale)
        integral = per_dimension("integral_gain", integral_gain)
        self.register_buffer("_integral_gain", integral * step / scale)
        derivative = per_dimension("derivative_gain", derivative_gain)
        self.register_buffer("_derivative_gain", derivative / step / scale)
        limit = torch.inf if clip is None else per_dimension("clip", clip, positive=True)
        self.register_buffer("_limit", torch.as_tensor(limit))

    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Return sum of errors, last error (both ``[*batch, n]``) and whether there was one."""
        zeros = torch.zeros_like(self.read(tensordict, self.position_key))
        seen = torch.zeros_like(zeros[..., :1], dtype=torch.bool)
        return {"error_sum": zeros, "last_error": zeros, "seen": seen}

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the clipped action ``[*batch, n]`` and advances the memory by one control step."""
        position = self.read(tensordict, self.position_key)
        goal = self.read(tensordict, self.goal_key)
        check_same_shape(
            self,
            position,
            goal,
            self._gain,
            self._integral_gain,
            self._derivative_gain,
            self._limit,
        )
        state = self.state_for(tensordict)
        error = goal - position
        error_sum = state["error_sum"] + error
        change = torch.where(state["seen"], error - state["last_error"], 0.0)
        action = (
            error * self._gain + error_sum * self._integral_gain + change * self._derivative_gain
        )
        clipped = torch.clamp(action, -self._limit, self._limit)
        winds_up = (action != clipped) & (action * error * self._integral_gain > 0)
        self.state = {
            "error_sum": torch.where(winds_up, state["error_sum"], error_sum),
            "last_error": error,
            "seen": torch.ones_like(state["seen"]),
        }
        return clipped
