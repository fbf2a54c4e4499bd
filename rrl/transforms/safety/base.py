"""The base of the safety limits: the last word on an action, and a record of when it was needed."""

from __future__ import annotations

from abc import abstractmethod

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite

from rrl.checks import missing, require
from rrl.keys import SAFETY
from rrl.transforms.base import ActionLimits, ActionTransform, Mask, Memory, sibling


class SafetyLimit(ActionTransform):
    """Base of the transforms that change an action which is not safe.

    In a list it stands before the disturbance and the residual: actions run from last to first, so
    it sees what would reach the environment, whoever asked for it. Of several, the first in the
    list has the last word; the order workspace, force, step keeps the box whatever the others do. A
    subclass says what it remembers of an observation (:meth:`measure`), what it makes of an action
    (:meth:`limit`), and what is safe if one of the two is NaN or infinite (:meth:`hold`). The
    measurement is taken at the transform's place in the list, before sensing faults and
    normalization.

    policy -> env: reads and writes ``action_key``.
    env -> policy: reads ``in_keys``, writes ("safety", name), bool ``[*batch, 1]``: whether this
    step's action violated the limit and was changed. False at a reset, but of an environment that
    resets itself within a step: there it is the ended episode's last step.

    Args:
        name: Names the entry below "safety".
        in_keys: Observations that :meth:`measure` reads.
        action_key: The action ``[*batch, n_act]`` in the environment's units; may be nested.
    """

    written = ("flag",)

    def __init__(self, name: str, in_keys: list[NestedKey], action_key: NestedKey) -> None:
        self._flag_key = sibling(action_key, (SAFETY, name))
        super().__init__(action_key=action_key, in_keys=in_keys, out_keys=[self._flag_key])

    @abstractmethod
    def measure(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return what to remember for the next step, ``[*batch, n]``.

        Args:
            tensordict: Observations at the transform's place.
            action: The executed action that led to them, ``[*batch, n_act]``; :meth:`start` at a
                reset.

        Raises:
            NotImplementedError: If a subclass has none.
        """
        raise missing(self, "measure")

    def start(self, tensordict: TensorDictBase) -> Tensor:
        """Return what counts as executed before an episode's first step, ``[*batch, n_act]``.

        By default zeros.
        """
        return self.nothing(tensordict)

    @abstractmethod
    def limit(self, action: Tensor, measured: Tensor, limits: ActionLimits) -> Tensor:
        """Return the safe action ``[*batch, n_act]``.

        It equals ``action`` bit for bit where that is safe.

        Raises:
            NotImplementedError: If a subclass has none.
        """
        raise missing(self, "limit")

    def hold(self, tensordict: TensorDictBase, measured: Tensor) -> Tensor:
        """Return the action ``[*batch, n_act]`` where command or measurement is not finite.

        By default zeros, which for a displacement is to stay.
        """
        return self.nothing(tensordict)

    def changed(self, action: Tensor, safe: Tensor) -> Tensor:
        """Return whether the limit was violated, bool ``[*batch, 1]``."""
        return (safe != action).any(-1, keepdim=True)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        limits, action = self.limits(), self.action(tensordict)
        measured = self.recall("measured")
        safe = self.limit(action, measured, limits).to(limits.dtype)
        known = finite(safe) & finite(measured)
        safe = torch.where(known, safe, self.hold(tensordict, measured).to(limits.dtype))
        safe = torch.clamp(safe, limits.low, limits.high)
        tensordict.set(self._flag_key, self.changed(action, safe))
        return self.give(tensordict, safe)

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        action = self.start(td)
        flag = torch.zeros_like(action[..., :1], dtype=torch.bool)
        return {"measured": self._measured(td, action), "flag": flag}

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        measured = self._measured(next_td, self.executed(td))
        return {"measured": measured, "flag": td.get(self._flag_key)}

    def _advance_or_start(
        self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask, started: Tensor
    ) -> Memory:
        memory = super()._advance_or_start(td, next_td, mask, started)
        return memory | {"flag": td.get(self._flag_key)}  # of the step that has ended the episode

    def _measured(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        measured = self.measure(tensordict, action)
        if not measured.is_floating_point():  # ticks of an encoder: limits are no whole numbers
            return measured.to(action.dtype)
        return measured.clone()  # an environment may change its own tensors in place

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the flag that says whether the last action was changed.

        Raises:
            ValueError: If an observation has no dimension beside the batch.
        """
        sizes = {}
        for key in self.in_keys:
            spec = require(self, observation_spec, key)
            if spec.ndim <= observation_spec.ndim:
                raise ValueError(
                    f"{key!r}: expected an observation of shape [*batch, n], got "
                    f"{tuple(spec.shape)} with the batch size {tuple(observation_spec.shape)}"
                )
            sizes[key] = spec.shape[-1]
        limits = self.limits()
        self.check_sizes(sizes, limits.shape[-1])
        shape = (*limits.shape[:-1], 1)
        flag = Binary(n=1, shape=shape, dtype=torch.bool, device=limits.low.device)
        return self.add_spec(observation_spec, self._flag_key, flag, "name of the limit")

    def check_sizes(self, sizes: dict[NestedKey, int], action_size: int) -> None:
        """Raise a ValueError if parameters, observations and action do not fit together.

        Args:
            sizes: Length of each observation in ``in_keys``.
            action_size: Length of the action.
        """


class CommandLimit(SafetyLimit):
    """Base of the limits that remember the last executed action, and no measurement.

    Args:
        name: See :class:`SafetyLimit`.
        start_key: Observation ``[*batch, n_act]`` that counts as executed before an episode's first
            step, where it is finite; None: zeros.
        action_key: See :class:`SafetyLimit`.
    """

    def __init__(self, name: str, start_key: NestedKey | None, action_key: NestedKey) -> None:
        super().__init__(name, [] if start_key is None else [start_key], action_key)

    def start(self, tensordict: TensorDictBase) -> Tensor:
        """Return the entry in ``start_key``, zeros where it is not finite."""
        nothing = super().start(tensordict)
        if not self.in_keys:
            return nothing
        given = require(self, tensordict, self.in_keys[0]).to(nothing)
        return torch.where(finite(given), given, nothing)

    def measure(self, tensordict: TensorDictBase, action: Tensor) -> Tensor:
        """Return the action that was executed."""
        return action

    def check_sizes(self, sizes: dict[NestedKey, int], action_size: int) -> None:
        """Hold the entry in ``start_key`` to the action's size."""
        check_sizes_equal(sizes, action_size)


def check_sizes_equal(sizes: dict[NestedKey, int], action_size: int) -> None:
    """Raise a ValueError unless each entry has one number for each dimension of the action.

    Raises:
        ValueError: If an entry has more or fewer.
    """
    for key, size in sizes.items():
        if size != action_size:
            raise ValueError(
                f"{key!r}: expected {action_size} numbers, one for each dimension of the action, "
                f"got {size}"
            )


def finite(values: Tensor) -> Tensor:
    """Return whether all numbers of a slot are finite, bool ``[*batch, 1]``."""
    return values.isfinite().all(-1, keepdim=True)
