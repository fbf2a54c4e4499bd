"""An operator who takes over for some steps, and what is learned from them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torchrl.data import Binary, Composite

from rrl.checks import check_length, per_dimension, require
from rrl.controllers.base import Controller
from rrl.keys import ACTION, INTERVENTION, OPERATOR_ACTION, TAKEN_OVER
from rrl.slot_masks import merge, shaped_like, step_mask
from rrl.transforms.base import ActionLimits, ActionTransform, Mask, Memory, share_within, sibling
from rrl.transforms.residual_action import ResidualAction

log = logging.getLogger(__name__)

ROUNDING = 1e-6
"""Half ranges by which a command may exceed the residual's authority before it is flagged."""


class Intervention(ActionTransform):
    r"""An operator's command in the place of the sum of controller and residual.

    In a list it stands in front of the :class:`~rrl.transforms.ResidualAction` that it corrects,
    and behind disturbances and safety limits, which hold for an operator too. The operator is asked
    with every observation, as the controller is, and says for each slot whether it has taken over,
    and what it commands. The residual that would have given the command is

        (command - base_action) / (scale * half_range),

    clipped to [-1, 1]; where no residual gives the command the step is flagged. Dimensions with a
    scale of 0 count as 0, and so does a base action that is not finite. A command that is not
    finite counts as not taken over. :func:`~rrl.interventions.relabel_interventions` puts it in the
    place of the policy's action, in a collector's ``postproc`` or before ``ReplayBuffer.extend``.

    After a handover, in either direction, the command goes from the last one straight to the new
    one's, by at most ``step_limit`` a step, until it has reached it. These steps are interventions
    too. What an episode begins with is no handover.

    policy -> env: reads and writes ``action_key``; reads the residual's ``base_action``.
    env -> policy: reads the operator's ``in_keys``; writes of the last step, at the level of the
    action, ("intervention", "active") and ("intervention", "exceeds"), bool ``[*batch, 1]``, and
    ("intervention", "action"), ``[*batch, n_act]``. False and zeros at a reset.

    Args:
        operator: A TensorDict module that writes "operator_action", ``[*batch, n_act]`` in the
            environment's action units, and "taken_over", bool ``[*batch, 1]``; or what makes one.
            A :class:`~rrl.controllers.StatefulController` in it has memory slot by slot.
        step_limit: Largest change of the command from step to step after a handover, in half ranges
            of the action, a number or one for each dimension, positive.
        action_key: The action ``[*batch, n_act]``; may be nested.

    Raises:
        TypeError: If the operator is no TensorDict module.
        ValueError: If the step limit is not positive or does not have the action's length; when
            run, if the operator's entries do not have their shapes.
        KeyError: If an entry that the operator reads, or one that it should write, is missing.
        RuntimeError: If no ResidualAction stands behind it, the environment resets itself, or
            actions pass the inverse without an environment.
    """

    written = ("active", "exceeds", "action")
    _claim: int | None = None  # on the operator's memory

    def __init__(
        self,
        operator: TensorDictModuleBase | Callable[[], TensorDictModuleBase],
        step_limit: float | Sequence[float],
        action_key: NestedKey = ACTION,
    ) -> None:
        module = operator if isinstance(operator, TensorDictModuleBase) else operator()
        if not isinstance(module, TensorDictModuleBase):
            raise TypeError(
                f"operator: expected a TensorDict module, or what makes one, got {operator!r}"
            )
        super().__init__(
            action_key=action_key,
            in_keys=list(module.in_keys),
            out_keys=[sibling(action_key, (INTERVENTION, name)) for name in self.written],
        )
        self.operator = module if isinstance(module, Controller) else _WithoutMemory(module)
        self.step_limit = per_dimension("step_limit", step_limit, positive=True)
        self._has_warned = False

    def residual_action(self) -> ResidualAction:
        """Return the transform that an operator overrules.

        Raises:
            RuntimeError: If none of the same action stands behind it in the environment's list.
        """
        for transform in self._later():
            if isinstance(transform, ResidualAction) and self._action_key in transform.in_keys_inv:
                return transform
        raise RuntimeError(
            f"Intervention: expected a ResidualAction of {self._action_key!r} behind it in the "
            "same list, got none; Compose(Intervention(...), ResidualAction(...))"
        )

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        limits, wanted = self.limits(), self.action(tensordict)
        engaged = self.recall("engaged")
        wanted = torch.where(engaged, self.recall("wanted"), wanted)
        wanted = torch.clamp(wanted, limits.low, limits.high)
        command, blending = self._blended(wanted, limits)
        residual = self.residual_action()
        span = residual.span()
        base_action = require(self, tensordict, residual.base_action_key)
        active = engaged | blending
        # What a residual comes to is clipped: one beyond the bounds gives the bounds.
        sums = (base_action - span, base_action + span)
        least, most = (torch.clamp(end, limits.low, limits.high) for end in sums)
        rounding = ROUNDING * limits.half_range
        within = (command >= least - rounding) & (command <= most + rounding)
        exceeds = ~within.all(-1, keepdim=True)  # so does whatever there is beside NaN
        change = command - base_action
        change = torch.where(change.isfinite(), change, 0.0)
        change = torch.where(span == 0, 0.0, change / torch.where(span == 0, 1.0, span))
        given = {
            "active": active,
            "exceeds": active & exceeds,
            "action": change.clamp(-1.0, 1.0),
            "command": command,
            "blending": blending,
        }
        mask = step_mask(tensordict, tensordict.batch_size)
        if mask is not None:
            given = merge(mask, given, {name: self.memory[name] for name in given})
        self.memory = {**self.memory, **given}
        return tensordict.set(self._action_key, command)

    def _blended(self, wanted: Tensor, limits: ActionLimits) -> tuple[Tensor, Tensor]:
        """Return the command, and where it is still on its way, bool ``[*batch, 1]``."""
        check_length("step_limit", self.step_limit, limits.shape[-1], "the action")
        last, limit = self.recall("command"), self.step_limit.to(wanted) * limits.half_range
        change = wanted - last
        share = share_within(change, limit)
        handed_over = self.recall("engaged") != self.recall("was_engaged")
        blending = (self.recall("blending") | handed_over) & (share < 1.0)
        return torch.where(blending, last + share * change, wanted), blending

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        self.residual_action()  # or a message before the first step
        if self.resets_itself():
            raise RuntimeError(
                "Intervention: expected an environment that is reset from outside, got one that "
                "resets itself, which hides what the last step of an episode wrote"
            )
        if mask is None:
            self._claim = self.operator.claim()
        self.operator.reset(mask)
        asked = self._ask(td, mask)
        nothing = self.nothing(td)
        false = torch.zeros_like(asked["engaged"])
        return {
            **{"active": false, "exceeds": false, "action": nothing},
            **{"command": nothing, "blending": false, "was_engaged": asked["engaged"]},
            **asked,
        }

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        was = {"was_engaged": self.recall("engaged")}
        return {**self.memory, **was, **self._ask(next_td, mask)}

    def _ask(self, tensordict: TensorDictBase, mask: Mask) -> Memory:
        """Return whether the operator has taken over, and what it commands."""
        operator, limits = self.operator, self.limits()
        operator.check_claim(self._claim)
        with operator.only(mask):
            said = operator(tensordict.copy())
        action = require(operator, said, OPERATOR_ACTION).to(limits.dtype)
        engaged = require(operator, said, TAKEN_OVER).bool()
        shape = self.shape_in(tensordict)
        expected = {OPERATOR_ACTION: shape, TAKEN_OVER: (*shape[:-1], 1)}
        for name, value in ((OPERATOR_ACTION, action), (TAKEN_OVER, engaged)):
            if tuple(value.shape) != tuple(expected[name]):
                raise ValueError(
                    f"{name}: expected the shape {tuple(expected[name])}, got {tuple(value.shape)}"
                )
        known = action.isfinite().all(-1, keepdim=True)
        lost = engaged & ~known
        if mask is not None:
            lost = lost & shaped_like(lost, mask)
        if lost.any() and not self._has_warned:
            self._has_warned = True
            log.warning(
                "%s: NaN or infinity; such a command counts as not taken over", OPERATOR_ACTION
            )
        return {"engaged": engaged & known, "wanted": torch.where(known, action, 0.0)}

    def _take_limits(self, action_spec: Composite) -> ActionLimits:
        limits = super()._take_limits(action_spec)
        self.operator.fit(limits.slot_middle(action_spec.ndim))
        return limits

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the two flags and the residual that would have given the command."""
        for key in self.in_keys:
            require(self.operator, observation_spec, key, group=True)
        limits, device = self.limits(), self.limits().low.device
        for key in self.out_keys[:2]:
            flag = Binary(n=1, shape=(*limits.shape[:-1], 1), dtype=torch.bool, device=device)
            self.add_spec(observation_spec, key, flag, "action_key")
        return self.add_spec(observation_spec, self.out_keys[2], self.action_like(), "action_key")


class _WithoutMemory(Controller):
    """Any TensorDict module as an operator; it writes its entries itself."""

    def __init__(self, module: TensorDictModuleBase) -> None:
        super().__init__(list(module.in_keys))
        self.module = module

    def act(self, tensordict: TensorDictBase) -> Tensor:
        return require(self.module, self(tensordict.copy()), OPERATOR_ACTION)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        with torch.no_grad():
            out: Any = self.module(tensordict)
        return out
