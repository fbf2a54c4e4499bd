"""What the safety limits share: the last word on an action, and the record of when they had to say it."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import Binary, Composite

from rrl.keys import EXECUTED_ACTION, SAFETY
from rrl.transforms.action import ActionTransform, sibling
from rrl.transforms.action_bounds import ActionLimits
from rrl.transforms.base import SlotTransform
from rrl.transforms.masks import merge, reset_mask, step_mask

__all__ = ["SafetyLimit"]


class SafetyLimit(ActionTransform, SlotTransform):
    """Base of the transforms that change an action which is not safe.

    In a list it stands before the disturbance and the residual: actions run from last to first, so it sees
    what would reach the environment, whoever asked for it. Of several, the first in the list has the last word;
    the order workspace, force, step keeps the box whatever the others do. A subclass says what it remembers of an
    observation (:meth:`measure`) and what it makes of an action (:meth:`limit`). The measurement is taken
    at the transform's place in the list, before sensing faults and normalisation.

    policy -> env: reads and writes ``action_key``; corrects "executed_action" where it is recorded.
    env -> policy: reads ``in_keys``, writes ("safety", name), bool ``[*batch, 1]``: whether this step's action
    violated the limit and was changed. False at a reset.

    Args:
        name: Names the entry below "safety".
        in_keys: Observations that :meth:`measure` reads.
        action_key: The action ``[*batch, n_act]`` in the environment's units; may be nested.

    """

    def __init__(self, name: str, in_keys: list[NestedKey], action_key: NestedKey) -> None:
        action_key = unravel_key(action_key)
        self._flag_key = unravel_key((sibling(action_key, SAFETY), name))
        self._executed_key = sibling(action_key, EXECUTED_ACTION)
        super().__init__(
            in_keys=in_keys,
            out_keys=[self._flag_key],
            in_keys_inv=[action_key],
            out_keys_inv=[action_key],
        )
        self._action_key = action_key
        self._flag: Tensor | None = None
        self._measured: Tensor | None = None

    @abstractmethod
    def measure(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return what to remember for the next step, ``[*batch, n]``.

        Args:
            tensordict: Observations at the transform's place.
            action: The action that led to them, ``[*batch, n_act]``; zeros at a reset.

        """

    @abstractmethod
    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Return the safe action ``[*batch, n_act]``, equal to ``action`` bit for bit where that is safe."""

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        limits = self._limits or self.limits()
        action = self.require(tensordict, self._action_key)
        if self._measured is None:
            raise RuntimeError(f"{type(self).__name__} needs a reset before the first step.")
        safe = torch.clamp(self.limit(action, self._measured, limits), limits.low, limits.high)
        tensordict.set(self._flag_key, (safe != action).any(-1, keepdim=True))
        if tensordict.get(self._executed_key, None) is not None:
            tensordict.set(self._executed_key, safe)
        return tensordict.set(self._action_key, safe)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        mask = step_mask(tensordict, next_tensordict.batch_size)
        limits = self._limits or self.limits()
        action = tensordict.get(self._action_key).to(limits.dtype)
        return self._remember(next_tensordict, action, tensordict.get(self._flag_key), mask)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        limits = self._limits or self.limits()
        action = torch.zeros(limits.shape, dtype=limits.dtype, device=limits.low.device)
        mask = reset_mask(tensordict, tensordict_reset.batch_size)
        return self._remember(
            tensordict_reset, action, torch.zeros_like(action[..., :1], dtype=torch.bool), mask
        )

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # An environment that reset itself within a step is reset by mask like any other.
        return self._reset(tensordict, tensordict_reset)

    def _remember(
        self, tensordict: TensorDictBase, action: Tensor, flag: Tensor, mask: Tensor | None
    ) -> TensorDictBase:
        measured = self.measure(tensordict, action)
        if mask is not None and self._measured is not None and self._flag is not None:
            measured = merge(mask, measured, self._measured)
            flag = merge(mask, flag, self._flag)
        # An environment may change its own tensors in place.
        self._measured, self._flag = measured.clone(), flag
        return tensordict.set(self._flag_key, flag)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Leave data outside an environment alone: there is no action on its way to anywhere."""
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the flag that says whether the last action was changed."""
        for key in self.in_keys:
            self.require_spec(observation_spec, key)
        if self._flag_key in observation_spec.keys(True, True):
            raise ValueError(
                f"The observations hold {self._flag_key!r} already. Give this limit another name."
            )
        limits = self.limits()
        self.check_sizes(observation_spec, limits.shape[-1])
        shape = (*limits.shape[:-1], 1)
        observation_spec[self._flag_key] = Binary(
            n=1, shape=shape, dtype=torch.bool, device=limits.low.device
        )
        return observation_spec

    def check_sizes(self, observation_spec: Composite, action_size: int) -> None:
        """Raise a ValueError if parameters, observations and action do not fit together."""

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Leave the action's spec as it is and remember its bounds."""
        self._take_limits(action_spec)
        return action_spec

    def get_extra_state(self) -> dict[str, Any]:
        """Return last measurement and flag for ``state_dict``."""
        return {"measured": self._measured, "flag": self._flag}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take measurement and flag from a ``state_dict``."""
        self._measured, self._flag = state["measured"], state["flag"]
