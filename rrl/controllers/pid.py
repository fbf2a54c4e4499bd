"""A controller with memory: proportional, integral and derivative action."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check_lengths, per_dimension
from rrl.controllers.base import State, StatefulController, clipped
from rrl.controllers.proportional import ProportionalController
from rrl.keys import BASE_ACTION


class PIDController(ProportionalController, StatefulController):
    """Cartesian PID control.

    With the error e = x_g - x the action is

        u = clip((K e + K_i sum(e) dt + K_d (e_t - e_{t-1}) / dt) / unit).

    In an episode's first step the derivative is zero. The integral stands still in a dimension
    whose action is clipped and would be driven further out (anti-windup by conditional
    integration), and wherever the error is not finite.

    Args:
        position_key: Position x, ``[*batch, n]`` [m].
        goal_key: Goal x_g, ``[*batch, n]`` [m], in the same frame.
        gain: K, a number or one for each dimension.
        integral_gain: K_i, a number or one for each dimension [1/s].
        derivative_gain: K_d, a number or one for each dimension [s].
        time_step: dt, the control step, positive [s].
        clip: Largest magnitude of the action, a number or one for each dimension, positive; None:
            no clipping.
        unit: Length that one unit of the action stands for, positive [m].
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
        super().__init__(position_key, goal_key, gain, clip, unit, out_key)
        scale = per_dimension("unit", unit)
        step = per_dimension("time_step", time_step, positive=True)
        integral = per_dimension("integral_gain", integral_gain)
        derivative = per_dimension("derivative_gain", derivative_gain)
        check_lengths(
            integral_gain=integral, derivative_gain=derivative, time_step=step, unit=scale
        )
        self.register_buffer("_integral_gain", integral * step / scale)
        self.register_buffer("_derivative_gain", derivative / step / scale)

    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Return sum of errors, last error (both ``[*batch, n]``) and whether there was one."""
        zeros = torch.zeros_like(self.error(tensordict))
        return {
            "error_sum": zeros,
            "last_error": zeros,
            "seen": torch.zeros_like(zeros, dtype=torch.bool),
        }

    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the clipped action ``[*batch, n]`` and advance the memory by one control step."""
        state, error = self.state_for(tensordict), self.error(tensordict)
        gains = self._gain, self._integral_gain, self._derivative_gain
        gain, integral_gain, derivative_gain = (value.to(error.dtype) for value in gains)
        total = state["error_sum"] + error
        change = torch.where(state["seen"], error - state["last_error"], 0.0)
        action = error * gain + total * integral_gain + change * derivative_gain
        executed = clipped(action, self._clip)
        known = error.isfinite()
        winds_up = (action != executed) & (action * error * integral_gain > 0)
        self.state = {
            "error_sum": torch.where(winds_up | ~known, state["error_sum"], total),
            "last_error": torch.where(known, error, state["last_error"]),
            "seen": state["seen"] | known,
        }
        return executed
