"""The policy's last actions among the observations."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import Composite, Unbounded

from rrl.keys import ACTION, PREVIOUS_ACTION
from rrl.transforms.action import ActionTransform, sibling
from rrl.transforms.base import SlotTransform
from rrl.transforms.masks import merge, reset_mask, step_mask

__all__ = ["ActionHistory"]


class ActionHistory(ActionTransform, SlotTransform):
    """Shows the policy what it said in the last steps.

    A delayed or noisy observation does not yet hold what the last actions did; together with them it is closer to a
    state. The actions are those at the transform's place: behind :class:`~rrl.transforms.ResidualAction` in the list
    they are the policy's residuals in [-1, 1], exploration included, in front of it what the environment was given.
    The action itself is left alone.

    policy -> env: reads ``action_key``.
    env -> policy: writes ``out_key``, ``[*batch, steps * n_act]``, oldest action first; zeros before an episode's
    first step.

    Args:
        steps: How many actions are remembered, at least 1.
        out_key: Default: "previous_action" at the level of ``action_key``.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        ValueError: If ``steps`` is not a whole number of at least 1, or the observations hold ``out_key`` already.
        KeyError: If the action is missing.
        RuntimeError: If it is called outside an environment, where there is no order in time, or before a reset.

    """

    def __init__(
        self, steps: int = 1, out_key: NestedKey | None = None, action_key: NestedKey = ACTION
    ) -> None:
        if steps < 1 or steps != int(steps):
            raise ValueError(f"steps must be a whole number of at least 1, got {steps!r}.")
        action_key = unravel_key(action_key)
        out_key = unravel_key(out_key or sibling(action_key, PREVIOUS_ACTION))
        super().__init__(
            in_keys=[], out_keys=[out_key], in_keys_inv=[action_key], out_keys_inv=[action_key]
        )
        self.steps = int(steps)
        self._action_key, self._out_key = action_key, out_key
        self._said: Tensor | None = None  # on its way to the environment
        self._history: Tensor | None = None  # (*batch, steps * n_act)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        self._said = self.require(tensordict, self._action_key)
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        said, history = self._said, self._history
        if said is None or history is None:
            raise RuntimeError("ActionHistory needs a reset before the first step.")
        renewed = torch.cat([history[..., said.shape[-1] :], said.to(history)], -1)
        return self._remember(
            next_tensordict, renewed, step_mask(tensordict, next_tensordict.batch_size)
        )

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        limits = self._limits or self.limits()
        nothing = torch.zeros_like(limits.low).repeat_interleave(self.steps, -1)
        return self._remember(
            tensordict_reset, nothing, reset_mask(tensordict, tensordict_reset.batch_size)
        )

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # An environment that reset itself within a step is reset by mask like any other.
        return self._reset(tensordict, tensordict_reset)

    def _remember(
        self, tensordict: TensorDictBase, history: Tensor, mask: Tensor | None
    ) -> TensorDictBase:
        if mask is not None and self._history is not None:
            history = merge(mask, history, self._history)
        self._history = history
        return tensordict.set(
            self._out_key, history.clone()
        )  # whoever changes it leaves the memory alone

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        raise RuntimeError(_NO_TIME)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Refuse: data outside an environment has no order in time."""
        raise RuntimeError(_NO_TIME)

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Leave the action's spec as it is and remember its size."""
        self._take_limits(action_spec)
        return action_spec

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the last actions, in the units of the action at this place."""
        if self._out_key in observation_spec.keys(True, True):
            raise ValueError(
                f"The observations hold {self._out_key!r} already. Pass another out_key."
            )
        limits = self.limits()
        shape = (*limits.shape[:-1], self.steps * limits.shape[-1])
        observation_spec[self._out_key] = Unbounded(
            shape=shape, device=limits.low.device, dtype=limits.dtype
        )
        return observation_spec

    def get_extra_state(self) -> dict[str, Any]:
        """Return the remembered actions for ``state_dict``."""
        return {"history": self._history}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take the remembered actions from a ``state_dict``."""
        self._history = state["history"]


_NO_TIME = (
    "ActionHistory remembers the actions of an environment; data outside one has no order in time. "
    "Append it to a TransformedEnv."
)
