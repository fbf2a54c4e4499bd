"""Superposition of controller and policy, the paper's equation for u."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.data import Bounded, Composite
from torchrl.envs.transforms import Transform

from rrl.checks import check_length, per_dimension, require
from rrl.controllers.base import Controller
from rrl.controllers.policy import PolicyController
from rrl.keys import ACTION, BASE_ACTION
from rrl.transforms.base import CASTS, ActionLimits, ActionTransform, Mask, Memory, sibling

_REMEDY = "; reset() and step() write it: give step() what they return, not an action alone"


class ResidualAction(ActionTransform):
    r"""Sum of controller and policy: :math:`u = \pi_H(s_m) + \pi_\theta(s_m, s_o)`.

    Two passes. With every observation, at reset and after a step, the controller runs on what the
    transforms before this one made of the observation, and its action is written to
    ``base_action_key``, where actor, critic and logger can read it. What normalizes it for them
    writes another entry, because on the way back to the environment the policy's action is added,

        u = clip(base_action + scale * half_range * action, low, high),

    with low, high and half_range = (high - low) / 2 those of the environment's action. The policy
    acts in [-1, 1]. Where the environment sets no bounds, the half range counts as 1 and nothing is
    clipped.

    env -> policy: reads the controller's ``in_keys``, writes ``base_action_key``.
    policy -> env: reads ``action_key`` and ``base_action_key``, writes ``action_key``.

    Args:
        controller: A :class:`~rrl.controllers.Controller`, or any TensorDict module without memory
            that writes ``base_action_key`` or ``action_key``, which is then copied, frozen and run
            without gradient and without exploration. Its action is cast to the environment's
            precision.
        scale: Authority of the residual in half ranges of the action, a number or one for each
            dimension, not negative. Where it is 0 the executed action is the controller's, bit for
            bit, whatever the policy asks for.
        base_action_key: Where the controller's action goes, ``[*batch, n_act]`` in the
            environment's units. Default: "base_action" at the level of ``action_key``.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        TypeError: If the controller is not a TensorDict module or the action is not continuous.
        ValueError: If a scale is negative or not finite, or the controller's action or the scale
            does not have the action's shape.
        KeyError: If the controller does not write one of the two keys, a key that it reads is not
            among the observations, or ``base_action`` is missing from a step's input.
        RuntimeError: If a later transform changes ``base_action``, or actions pass the inverse
            without an environment, as in ``ReplayBuffer.extend``.
    """

    keeps_units = False
    _claim: int | None = None  # on the controller's memory

    def __init__(
        self,
        controller: TensorDictModuleBase,
        scale: float | Sequence[float] = 1.0,
        base_action_key: NestedKey | None = None,
        action_key: NestedKey = ACTION,
    ) -> None:
        base_key = unravel_key(base_action_key or sibling(action_key, BASE_ACTION))
        if not isinstance(controller, Controller):
            name = _written(controller, base_key, unravel_key(action_key))
            controller = PolicyController(controller, action_key=name, out_key=base_key)
        super().__init__(
            action_key=action_key, in_keys=list(controller.in_keys), out_keys=[base_key]
        )
        self.controller = controller
        self.base_action_key = base_key
        self.set_scale(scale)

    def set_scale(self, scale: float | Sequence[float] | Tensor) -> None:
        """Change the authority of the residual, from the next step on.

        Args:
            scale: In half ranges of the action, a number or one for each dimension, not negative.
        """
        self.scale = per_dimension("scale", scale, minimum=0.0)
        self._span: Tensor | None = None  # the scale in action units

    def check_later(self, transform: Transform) -> None:
        """Raise an error if a later transform changes what is executed.

        Raises:
            RuntimeError: If it writes ``base_action`` in its place, or hands the action on twice.
        """
        super().check_later(transform)
        changes = self.base_action_key in map(unravel_key, transform.out_keys or ())
        # Of two that write the same new entry the specs tell.
        if changes and not isinstance(transform, (*CASTS, ResidualAction)):
            raise RuntimeError(
                f"{self.base_action_key!r}: expected what the controller said, which is executed, "
                f"got a {type(transform).__name__} that changes it for the policy; give that one "
                "another entry to write (out_keys)"
            )

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        if self._limits is None and self.container is not None:
            self.limits()  # tells the controller the action's size
        if mask is None:
            self._claim = self.controller.claim()
        self.controller.reset(mask)
        return self._base_action(td, mask)

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        return self._base_action(next_td, mask)

    def _advance_or_start(
        self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask, started: Tensor
    ) -> Memory:
        self.controller.reset(started)  # and then run once, in all slots
        return self._base_action(next_td, mask)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the base action outside an environment, for example in front of an actor."""
        action = self._base_action(tensordict, None)["base_action"]
        return tensordict.set(self.base_action_key, action)

    def _base_action(self, tensordict: TensorDictBase, mask: Mask) -> Memory:
        controller, limits = self.controller, self._limits
        controller.check_claim(self._claim)
        with controller.only(mask):
            action = controller.act(tensordict)
        if not isinstance(action, Tensor):
            raise TypeError(
                f"{controller.called()}: expected act() to return a tensor [*batch, n_act], got "
                f"{'None' if action is None else f'a {type(action).__name__}'}"
            )
        if limits is None:
            return {"base_action": action}
        if action.shape != (shape := self.shape_in(tensordict)):
            raise ValueError(
                f"{controller.called()}: expected an action of shape {tuple(shape)}, "
                f"got {tuple(action.shape)}"
            )
        return {"base_action": action.to(limits.dtype)}

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        limits = self.limits()
        action = self.action(tensordict)
        base_action = require(self, tensordict, self.base_action_key, _REMEDY)
        span = self.span()
        # Product and sum are rounded one after the other: a fused operation would round differently
        # in different places of a batch.
        total = base_action + span * action
        if self._has_zeros:
            total = torch.where(span == 0, base_action, total)
        return tensordict.set(self._action_key, torch.clamp(total, limits.low, limits.high))

    def span(self) -> Tensor:
        """Return the largest residual in the environment's action units, of the action's shape."""
        if self._span is None:
            limits = self.limits()
            check_length("scale", self.scale, limits.shape[-1], "the action")
            self._span = self.scale.to(limits.half_range) * limits.half_range
            self._has_zeros = bool((self._span == 0).any())
        return self._span

    def _take_limits(self, action_spec: Composite) -> ActionLimits:
        self._span = None
        limits = super()._take_limits(action_spec)
        self.controller.fit(limits.slot_middle(action_spec.ndim))
        return limits

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Show the policy an action in [-1, 1] instead of the environment's."""
        limits = self._take_limits(action_spec)
        action_spec[self._action_key] = Bounded(
            -1.0, 1.0, shape=limits.shape, device=limits.low.device, dtype=limits.dtype
        )
        return action_spec

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``base_action``, in the environment's action units."""
        for key in self.in_keys:
            require(self.controller.called(), observation_spec, key, group=True)
        return self.add_spec(
            observation_spec, self.base_action_key, self.action_like(), "base_action_key"
        )

    def get_extra_state(self) -> dict[str, Any]:
        """Return scale and last base action for ``state_dict``."""
        return {**super().get_extra_state(), "scale": self.scale}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take scale and last base action from a ``state_dict``."""
        super().set_extra_state(state)
        self.set_scale(state["scale"])


def _written(controller: Any, *keys: NestedKey) -> NestedKey:
    """Return the first of ``keys`` that a module writes.

    Raises:
        TypeError: If it is no TensorDict module.
        KeyError: If it writes none of them.
    """
    if not isinstance(controller, nn.Module) or not hasattr(controller, "in_keys"):
        kind = type(controller).__name__
        got = f"the class {controller.__name__}" if isinstance(controller, type) else f"a {kind}"
        raise TypeError(
            "controller: expected a Controller or a TensorDict module with in_keys and out_keys, "
            f"got {got}; {_remedy(controller)}"
        )
    written = [unravel_key(key) for key in getattr(controller, "out_keys", ())]
    for key in keys:
        if key in written:
            return key
    raise KeyError(
        f"controller: expected a module that writes {' or '.join(map(repr, keys))}, got one that "
        f"writes {written}; name its action so, in out_keys"
    )


def _remedy(given: Any) -> str:
    made = given.func if isinstance(given, partial) else given
    if isinstance(made, type) and issubclass(made, nn.Module):
        return "call it"
    wrap = "wrap it in a FunctionController"
    return f"call it if it makes one, else {wrap}" if isinstance(given, partial) else wrap
