"""Transforms that change or watch an action."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs.transforms import DeviceCastTransform, DTypeCastTransform, Transform

from rrl.checks import require
from rrl.transforms.base.action_bounds import ActionLimits, action_leaf, limits_of
from rrl.transforms.base.slots import SlotTransform

CASTS = (DeviceCastTransform, DTypeCastTransform)
"""Transforms that leave numbers as they are, but for their precision."""


class ActionTransform(SlotTransform):
    """Base of the transforms that change or watch an action and need its limits at their place.

    Args:
        action_key: The action ``[*batch, n_act]``; may be nested.
        keys: Arguments of the next base class: keys, seeds.
    """

    keeps_units = True
    """Whether the action leaves in the units in which it comes."""

    _limits: ActionLimits | None = None
    _batch_dims = 0  # of the environment
    _arrives_in_units = True  # in those of this place, at the environment

    def __init__(self, *, action_key: NestedKey, **keys: Any) -> None:
        key = unravel_key(action_key)
        super().__init__(in_keys_inv=[key], out_keys_inv=[key], **keys)
        self._action_key = key

    def limits(self) -> ActionLimits:
        """Return the limits of the action as the transforms nearer to the environment leave it.

        Raises:
            RuntimeError: If the transform is not attached to an environment.
        """
        if self._limits is not None:
            return self._limits
        parent = self.parent
        if parent is None:
            raise RuntimeError(
                f"{type(self).__name__}: expected an action on its way to an environment, but it "
                "is attached to none; append it to a TransformedEnv (in a replay buffer it would "
                "change the stored actions a second time)"
            )
        return self._take_limits(parent.full_action_spec)

    def _take_limits(self, action_spec: Composite) -> ActionLimits:
        self._limits = limits_of(action_leaf(action_spec, self._action_key))
        self._batch_dims = action_spec.ndim
        self._arrives_in_units = all(map(self._leaves_units, self._nearer()))
        return self._limits

    def shape_in(self, tensordict: TensorDictBase) -> torch.Size:
        """Return the action's shape for the slots of ``tensordict``.

        These are the environment's, unless it takes any number of them (``batch_locked`` is False).
        """
        shape = self.limits().shape
        return tensordict.batch_size + shape[self._batch_dims :]

    def nothing(self, tensordict: TensorDictBase) -> Tensor:
        """Return an action of zeros for the slots of ``tensordict``."""
        return self.limits().low.new_zeros(self.shape_in(tensordict))

    def action(self, tensordict: TensorDictBase) -> Tensor:
        """Return the action ``[*batch, n_act]`` in the precision and on the device of here."""
        return require(self, tensordict, self._action_key).to(self.limits().low)

    def give(self, tensordict: TensorDictBase, action: Tensor) -> TensorDictBase:
        """Hand an action ``[*batch, n_act]`` on towards the environment."""
        if not self._arrives_in_units:
            tensordict.set(self._given_key, action)
        return tensordict.set(self._action_key, action)

    def executed(self, tensordict: TensorDictBase) -> Tensor:
        """Return the action ``[*batch, n_act]`` that was executed, in the units at this place.

        Where transforms nearer to the environment change the units, that is what :meth:`give` was
        given.

        Args:
            tensordict: Input of the environment's step.
        """
        if self._arrives_in_units:
            return self.action(tensordict)
        return require(self, tensordict, self._given_key)

    @property
    def _given_key(self) -> NestedKey:
        return unravel_key(("_given", self.out_keys[0]))

    def _nearer(self) -> Iterator[Transform]:
        """Yield the transforms between this one and the environment."""
        for module in () if self.container is None else self.container.transform.modules():
            if module is self:
                return
            if isinstance(module, Transform):
                yield module

    def _leaves_units(self, transform: Transform) -> bool:
        keys = (*(transform.in_keys_inv or ()), *(transform.out_keys_inv or ()))
        if self._action_key not in keys or isinstance(transform, CASTS):
            return True
        return isinstance(transform, ActionTransform) and transform.keeps_units

    def action_like(self, size: int | None = None) -> Unbounded:
        """Return the spec of an observation of the action's shape, or with ``size`` numbers."""
        limits = self.limits()
        shape = limits.shape if size is None else (*limits.shape[:-1], size)
        return Unbounded(shape=shape, device=limits.low.device, dtype=limits.dtype)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Leave data outside an environment alone: there is no action on its way to anywhere."""
        return tensordict

    def transform_action_spec(self, action_spec: Composite) -> Composite:
        """Leave the action's spec as it is and remember its bounds."""
        self._take_limits(action_spec)
        return action_spec

    def clone(self) -> ActionTransform:
        """Return a copy without a parent; it reads its limits anew."""
        twin = super().clone()
        twin._limits = None
        return twin

    def empty_cache(self) -> None:
        """Forget what was derived from the environment's specs."""
        super().empty_cache()
        self._limits = None

    def reset_parent(self) -> None:
        """Detach the transform from its environment."""
        super().reset_parent()
        self._limits = None


def sibling(key: NestedKey, name: NestedKey) -> NestedKey:
    """Return ``name`` at the level of ``key``: ("arm", "action") -> ("arm", name)."""
    key = unravel_key(key)
    return unravel_key(name if isinstance(key, str) else (*key[:-1], name))
