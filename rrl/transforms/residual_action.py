"""Superposition of controller and policy, the paper's equation for u."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded

from rrl.checks import check_length, per_dimension
from rrl.controllers.base import Controller
from rrl.controllers.policy import PolicyController
from rrl.keys import ACTION, BASE_ACTION
from rrl.transforms.action import ActionTransform, sibling
from rrl.transforms.action_bounds import ActionLimits
from rrl.transforms.base import SlotTransform
from rrl.transforms.masks import merge, reset_mask, step_mask

__all__ = ["ResidualAction"]

_MISSING_BASE_ACTION = "reset() and step() write it: give step() what they return (through step_mdp), not an action alone. "


class ResidualAction(ActionTransform, SlotTransform):
    r"""Adds the policy's action to a controller's: :math:`u = \pi_H(s_m) + \pi_\theta(s_m, s_o)`.

    Two passes. With every observation, at reset and after a step, the controller runs on what the
    transforms before this one made of the observation, and its action is written to
    ``base_action_key``, where actor, critic and logger can read it. On the way back to the
    environment the policy's action is added,

        u = clip(base_action + scale * half_range * action, low, high),

    with low, high and half_range = (high - low) / 2 those of the environment's action. The policy
    acts in [-1, 1]. Where the environment sets no bounds, the half range counts as 1 and nothing is
    clipped.

    env -> policy: reads the controller's in_keys, writes ``base_action_key``.
    policy -> env: reads ``action_key`` and ``base_action_key``, writes ``action_key``.

    Args:
        controller: A :class:`~rrl.controllers.Controller`, or any TensorDict module that writes
            ``base_action_key`` or ``action_key``, which is then copied, frozen and run without
            gradient and without exploration.
        scale: Authority of the residual in half ranges of the action, a number or one a dimension,
            not negative. With 0 the executed action is the controller's, bit for bit.
        base_action_key: Where the controller's action goes, ``[*batch, n_act]`` in the
            environment's units. Default: "base_action" at the level of ``action_key``.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        TypeError: If the controller is not a TensorDict module or the action is not continuous.
        ValueError: If a scale is negative or not finite, or the controller's action or the scale
            does not have the action's shape.
        KeyError: If a key that the controller reads is not among the observations, or
            ``base_action`` is missing from a step's input.
        RuntimeError: If actions pass the inverse without an environment, as in
            ``ReplayBuffer.extend``.

    """

    def __init__(
        self,
        controller: TensorDictModuleBase,
        scale: float | Sequence[float] = 1.0,
        base_action_key: NestedKey | None = None,
        action_key: NestedKey = ACTION,
    ) -> None:
        action_key = unravel_key(action_key)
        base_action_key = unravel_key(base_action_key or sibling(action_key, BASE_ACTION))
        if not isinstance(controller, Controller):
            said = (
                base_action_key
                if base_action_key in getattr(controller, "out_keys", ())
                else action_key
            )
            controller = PolicyController(controller, action_key=said, out_key=base_action_key)
        super().__init__(
            in_keys=list(controller.in_keys),
            out_keys=[base_action_key],
            in_keys_inv=[action_key],
            out_keys_inv=[action_key],
        )
        self.controller = controller
        self._action_key = action_key
        self._base_key = base_action_key
        self._base_action: Tensor | None = None
        self._span: Tensor | None = None
        self.set_scale(scale)

    def set_scale(self, scale: float | Sequence[float] | Tensor) -> None:
        """Change the authority of the residual, from the next step on.

        Args:
            scale: In half ranges of the action, a number or one a dimension, not negative.

        """
        self.scale = per_dimension("scale", scale, minimum=0.0)
        self._span = None

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if self._limits is None and self.container is not None:
            self.limits()
        mask = reset_mask(tensordict, tensordict_reset.batch_size)
        self.controller.reset(mask)
        return self._write_base_action(tensordict_reset, mask)

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        # An environment that reset itself within a step is reset by mask like any other.
        return self._reset(tensordict, tensordict_reset)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        mask = step_mask(tensordict, next_tensordict.batch_size)
        return self._write_base_action(next_tensordict, mask)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write_base_action(next_tensordict, None)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the base action outside an environment, for example in front of an actor."""
        return self._write_base_action(tensordict, None)

    def _write_base_action(self, tensordict: TensorDictBase, mask: Tensor | None) -> TensorDictBase:
        controller = self.controller
        if mask is None:
            base_action = controller.act(tensordict)
        else:
            # Slots in the middle of an episode keep their action and their controller's state.
            before = controller.snapshot()
            base_action = controller.act(tensordict)
            controller.restore(before, ~mask)
        limits = self._limits
        if limits is not None:
            if base_action.shape != limits.shape:
                raise ValueError(
                    f"The controller must give an action of shape {tuple(limits.shape)}, "
                    f"{type(controller).__name__} gave {tuple(base_action.shape)}."
                )
            base_action = base_action.to(limits.dtype)
        if mask is not None and self._base_action is not None:
            base_action = merge(mask, base_action, self._base_action)
        self._base_action = base_action
        return tensordict.set(self._base_key, base_action)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        limits = self._limits or self.limits()
        action = self.require(tensordict, self._action_key)
        base_action = tensordict.get(self._base_key, None)
        if base_action is None:
            self.require(tensordict, self._base_key, _MISSING_BASE_ACTION)
        span = self._span
        if span is None:
            span = self._make_span(limits)
        # Product and sum are rounded one after the other: a fused operation would round differently
        # in different places of a batch.
        executed = torch.clamp(base_action + span * action, limits.low, limits.high)
        return tensordict.set(self._action_key, executed)

    def _make_span(self, limits: ActionLimits) -> Tensor:
        scale = self.scale.to(device=limits.low.device, dtype=limits.dtype)
        check_length("scale", scale, limits.shape[-1], "the action")
        self._span = scale * limits.half_range
        return self._span

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Show the policy an action in [-1, 1] instead of the environment's."""
        limits = self._take_limits(action_spec)
        action_spec[self._action_key] = Bounded(
            -1.0, 1.0, shape=limits.shape, device=limits.low.device, dtype=limits.dtype
        )
        return action_spec

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``base_action``, in the environment's action units."""
        present = observation_spec.keys(True, True)
        for key in self.in_keys:
            self.require_spec(observation_spec, key)
        if self._base_key in present:
            raise ValueError(
                f"The observations hold {self._base_key!r} already. Pass another base_action_key."
            )
        limits = self.limits()
        observation_spec[self._base_key] = Unbounded(
            shape=limits.shape, device=limits.low.device, dtype=limits.dtype
        )
        return observation_spec

    def _take_limits(self, action_spec: Any) -> ActionLimits:
        self._span = None
        limits = super()._take_limits(action_spec)
        for module in self.controller.modules():
            if isinstance(module, Controller):
                module.fit(limits.shape[-1])
        return limits

    def get_extra_state(self) -> dict[str, Any]:
        """Return scale and last base action for ``state_dict``."""
        return {"scale": self.scale, "base_action": self._base_action}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take scale and last base action from a ``state_dict``."""
        self.set_scale(state["scale"])
        self._base_action = state["base_action"]
