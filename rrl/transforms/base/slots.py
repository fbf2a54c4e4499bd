"""Transforms with memory and random numbers for each slot of a batch."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.envs.transforms import (
    ConditionalPolicySwitch,
    FrameSkipTransform,
    MultiAction,
    NoopResetEnv,
    Transform,
)

from rrl.checks import missing
from rrl.slot_masks import any_done, merge, reset_mask, resets_itself, step_mask
from rrl.slot_random import Seeded, SlotGenerators

Mask = Tensor | None
"""Slots, bool ``[*batch]``; None: all of them."""

Memory = dict[str, Tensor]
"""Tensors ``[*batch, ...]`` by name."""

STEPPERS = (ConditionalPolicySwitch, FrameSkipTransform, MultiAction, NoopResetEnv)
"""Transforms that take steps of their own, through copies of what stands in front of them."""


class SlotTransform(Transform):
    """A transform with memory, held slot by slot.

    A subclass says what a slot remembers when its episode starts (:meth:`_first`) and after a step
    (:meth:`_advance`). What goes with it is done here: resets and steps of some of the slots,
    environments that reset themselves within a step, ``state_dict`` and clones. A transform that
    takes steps of its own, such as a FrameSkipTransform, stands in front of it, nearer to the
    environment.

    ``memory`` is replaced and never changed in place: a clone may start from the same tensors.
    """

    written: Iterable[str] | None = None
    """Names of what is written to ``out_keys``, in their order; None: all that is remembered."""

    def __init__(self, **keys: Sequence[NestedKey]) -> None:
        super().__init__(**keys)
        self.memory: Memory = {}

    @abstractmethod
    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        """Return the memory at the start of an episode.

        Args:
            td: First observations of the episode, at the transform's place in the chain.
            mask: Slots that start an episode. What is returned for other slots does not count.
        """
        raise missing(self, "_first")

    @abstractmethod
    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        """Return the memory after a step.

        Args:
            td: Input of the environment's step, with the executed action.
            next_td: Its outcome, at the transform's place in the chain.
            mask: Slots that were stepped. What is returned for other slots does not count.
        """
        raise missing(self, "_advance")

    def _advance_or_start(
        self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask, started: Tensor
    ) -> Memory:
        """Return the memory after a step within which the slots in ``started`` were reset."""
        memory = self._advance(td, next_td, mask)
        return merge(started, self._first(next_td, started), memory)

    def _outputs(self) -> Iterable[Tensor]:
        """Return what is written to each of ``out_keys``."""
        return [self.memory[name] for name in self.written or self.memory]

    def recall(self, name: str) -> Tensor:
        """Return something remembered.

        Raises:
            RuntimeError: If nothing was remembered yet.
        """
        if name in self.memory:
            return self.memory[name]
        raise RuntimeError(f"{type(self).__name__}: expected a reset before the first step")

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        for transform in self._later():
            self.check_later(transform)
        mask = reset_mask(tensordict, tensordict_reset.batch_size)
        return self._remember(tensordict_reset, self._first(tensordict_reset, mask), mask)

    def _later(self) -> Iterator[Transform]:
        """Yield the transforms between this one and the policy."""
        behind = False
        for module in () if self.container is None else self.container.transform.modules():
            if behind and isinstance(module, Transform):
                yield module
            behind = behind or module is self

    def check_later(self, transform: Transform) -> None:
        """Raise an error if a transform between this one and the policy would disturb it.

        Raises:
            RuntimeError: If it takes steps that this one does not see.
        """
        if isinstance(transform, STEPPERS):
            kind = type(transform).__name__
            place = "first in the list"
            if isinstance(transform, MultiAction):
                place = "around this environment: TransformedEnv(env, ..., auto_unwrap=False)"
            raise RuntimeError(
                f"{type(self).__name__}: expected to see every step and every action once, got a "
                f"{kind} behind it, which takes steps of its own; put the {kind} {place}"
            )

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        mask = step_mask(tensordict, next_tensordict.batch_size)
        if self.resets_itself():
            # Here, not in _reset_on_native_autoreset, which sees what later transforms have made
            # of the first observations.
            started = any_done(next_tensordict)
            started = started if mask is None else started & mask
            memory = self._advance_or_start(tensordict, next_tensordict, mask, started)
        else:
            memory = self._advance(tensordict, next_tensordict, mask)
        return self._remember(next_tensordict, memory, mask)

    def _remember(self, tensordict: TensorDictBase, memory: Memory, mask: Mask) -> TensorDictBase:
        if mask is not None and self.memory:
            memory = merge(mask, memory, self.memory)
        self.memory = memory
        for key, value in zip(self.out_keys, self._outputs(), strict=True):
            tensordict.set(key, value.clone())  # whoever changes it leaves the memory alone
        return tensordict

    def resets_itself(self) -> bool:
        """Return whether the environment starts the next episode within the step that ends one."""
        env = self.container
        return env is not None and resets_itself(env)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self.forward(next_tensordict)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Refuse data outside an environment, such as samples of a replay buffer.

        Raises:
            RuntimeError: Always.
        """
        raise RuntimeError(
            f"{type(self).__name__}: expected steps of an environment, got data without an order "
            "in time; append it to a TransformedEnv"
        )

    def add_spec(
        self, observation_spec: Composite, key: NestedKey, spec: TensorSpec, parameter: str
    ) -> Composite:
        """Declare a new observation.

        Raises:
            ValueError: If there is one of that name; the message names the ``parameter`` to change.
        """
        if key in observation_spec.keys(True, True):
            raise ValueError(
                f"{parameter}: expected a name that no observation has, got {key!r}; pass another"
            )
        observation_spec[key] = spec
        return observation_spec

    def clone(self) -> SlotTransform:
        """Return a copy without a parent that shares no state with this transform."""
        twin = super().clone()
        for name, value in twin.__dict__.items():
            if isinstance(value, SlotGenerators):
                twin.__dict__[name] = copy.deepcopy(value)
        for table in (twin._modules, twin._buffers):
            for name, value in table.items():
                table[name] = copy.deepcopy(value)
        return twin

    def get_extra_state(self) -> dict[str, Any]:
        """Return the memory for ``state_dict``."""
        return {"memory": self.memory}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take the memory from a ``state_dict``."""
        self.memory = state["memory"]


class RandomTransform(Seeded, SlotTransform):
    """A slot transform that draws numbers, each slot from its own generator.

    Args:
        seed: Seed of slot 0; slot i uses ``seed + i``. None: a new seed is drawn from torch's
            global generator at every reset of all slots, so ``torch.manual_seed`` and
            ``ParallelEnv.set_seed`` govern it.
        stream: Name that tells this transform's numbers from those of others with the same seed.

    Attributes:
        generators: What a subclass draws from.
    """

    def __init__(self, *, seed: int | None, stream: str, **keys: Sequence[NestedKey]) -> None:
        super().__init__(**keys)
        self.generators = SlotGenerators(seed, stream)

    def silence(self) -> None:
        """Take away the fault and keep the entries: a real sensor or actuator has its own.

        Raises:
            NotImplementedError: If the transform does not say what is left without the fault.
        """
        raise NotImplementedError(
            f"{type(self).__name__}: expected a method silence(), which leaves the entries and "
            "takes away the fault; a policy is exported without simulated faults"
        )

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if reset_mask(tensordict, tensordict_reset.batch_size) is None:
            self.generators.renew()
        return super()._reset(tensordict, tensordict_reset)

    def get_extra_state(self) -> dict[str, Any]:
        """Return memory and generators for ``state_dict``."""
        return super().get_extra_state() | {"generators": self.generators.state_dict()}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take memory and generators from a ``state_dict``."""
        super().set_extra_state(state)
        self.generators.load_state_dict(state["generators"])
