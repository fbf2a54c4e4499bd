"""A guard against commands that are not numbers."""

from __future__ import annotations

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check, require
from rrl.keys import ACTION, BASE_ACTION
from rrl.slot_masks import shaped_like, step_mask, truncate
from rrl.transforms.base import ActionLimits, sibling
from rrl.transforms.safety.base import CommandLimit, finite

_REPLACEMENTS = ("last", "zero", "controller")


class FiniteAction(CommandLimit):
    """A replacement for commands with NaN or infinity, within the same step.

    A broken sensor, controller or network gives them, and clipping lets NaN pass. In the list it
    stands behind the other limits and before disturbance and residual, so that the other limits
    have the last word on what it puts in.

    policy -> env: reads and writes ``action_key``; reads "base_action" beside it, for
    "controller" only.
    env -> policy: reads ``start_key``, writes ("safety", "finite"), and with ``truncate`` sets
    "truncated" and "done"; see :class:`SafetyLimit`.

    Args:
        replacement: The command of a slot whose command is not finite. "last": what was executed in
            the last step, right for absolute targets; in an episode's first step ``start_key``.
            "zero": zeros, right for displacements and velocities. "controller": the controller's
            action, and "last" where that is not finite either.
        truncate: Whether the episode ends with such a step. A controller with memory may have
            remembered the NaN, and starts anew with the next episode. An environment that resets
            itself within a step cannot be told to, and goes on.
        start_key: Observation ``[*batch, n_act]`` of what the robot holds at a reset, in the
            action's units; zeros count where it is not finite. None: zeros.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If ``replacement`` is unknown, or the start does not have the action's length.
        KeyError: If an action or the start is missing.
        RuntimeError: If actions pass the inverse without an environment or before a reset.
    """

    def __init__(
        self,
        replacement: str = "last",
        truncate: bool = True,
        action_key: NestedKey = ACTION,
        start_key: NestedKey | None = None,
    ) -> None:
        super().__init__("finite", start_key, action_key)
        expected = f"one of {', '.join(_REPLACEMENTS)}"
        check("replacement", replacement, expected, replacement in _REPLACEMENTS)
        self.replacement, self.truncate = replacement, bool(truncate)
        self._base_key = sibling(action_key, BASE_ACTION)

    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Return the action as it is; :meth:`hold` replaces what is not finite."""
        return action

    def changed(self, action: Tensor, safe: Tensor) -> Tensor:
        """Return whether the command was not finite; clipping at the bounds does not count."""
        return ~finite(action)

    def hold(self, tensordict: TensorDictBase, measured: Tensor) -> Tensor:
        """Return the replacement ``[*batch, n_act]``."""
        if self.replacement == "zero":
            return super().hold(tensordict, measured)
        if self.replacement == "last":
            return measured
        base_action = require(self, tensordict, self._base_key).to(measured.dtype)
        return torch.where(finite(base_action), base_action, measured)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        super()._step(tensordict, next_tensordict)
        ends = tensordict.get(self._flag_key)
        if self.truncate and not self.resets_itself() and ends.any():
            mask = step_mask(tensordict, next_tensordict.batch_size)
            truncate(next_tensordict, ends if mask is None else ends & shaped_like(ends, mask))
        return next_tensordict
