"""The interface of a controller: a module from observation keys to the base action."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from rrl.checks import missing, require
from rrl.keys import BASE_ACTION
from rrl.slot_masks import merge

State = dict[str, Any]
"""Tensors ``[*batch, ...]`` by name; dictionaries may nest."""


_CLAIMS = count(1)


class Controller(TensorDictModuleBase):
    """Base of all controllers, pi_H(s_m) in the paper (section IV, equation of the superposition).

    A controller reads ``in_keys`` and writes one action to ``out_key``, in the action units of the
    environment that it drives. A subclass implements :meth:`act`.

    Args:
        in_keys: Observation keys that :meth:`act` reads; they may be nested.
        out_key: Key that the action is written to.
    """

    def __init__(self, in_keys: Sequence[NestedKey], out_key: NestedKey = BASE_ACTION) -> None:
        super().__init__()
        keys = [in_keys] if isinstance(in_keys, str) else in_keys
        self.in_keys = [unravel_key(key) for key in keys]
        self.out_keys = [unravel_key(out_key)]

    @abstractmethod
    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Return the action ``[*batch, n_act]`` and leave ``tensordict`` as it is.

        Raises:
            KeyError: If an observation key is missing.
        """
        raise missing(self, "act")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action to ``tensordict`` and return it."""
        return tensordict.set(self.out_keys[0], self.act(tensordict))

    def read(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        """Return a copy of an entry, or raise a KeyError that says what there is instead.

        What :meth:`act` writes into it does not reach those who read the entry after it.
        """
        return require(self.called(), tensordict, key).clone()

    def called(self) -> str:
        """Return what messages call it: the name of its class."""
        return type(self).__name__

    def fit(self, middle: Tensor) -> None:
        """Learn the middle ``[n_act]`` of the bounds of a slot's action before the first call.

        Of several agents it is ``[n, n_act]``. Controllers inside this one learn it too.
        """
        for controller in _nearest(self):
            controller.fit(middle)

    def claim(self) -> int:
        """Give the memory to whoever drives the controller from now on.

        Returns:
            What its driver hands to :meth:`check_claim`.
        """
        claim = next(_CLAIMS)
        for module in self.stateful():
            module.claimed = claim
        return claim

    def check_claim(self, claim: int | None) -> None:
        """Raise an error if somebody else drives the controller by now.

        Args:
            claim: What :meth:`claim` has returned; None: nothing was, as where a state was loaded.

        Raises:
            RuntimeError: If somebody has claimed it since; its memory is of other episodes.
        """
        for module in () if claim is None else self.stateful():
            if module.claimed != claim:
                raise RuntimeError(
                    f"{module.called()}: expected one environment or operator, whose episodes it "
                    "remembers, got a second one that has begun episodes since; make a controller "
                    "for each"
                )

    def reset(self, mask: Tensor | None = None) -> None:
        """Start a new episode where ``mask`` (bool ``[*batch]``) is True; None: in all slots."""
        for module in self.stateful():
            module.reset_state(mask)

    @contextmanager
    def only(self, mask: Tensor | None) -> Iterator[None]:
        """Change the memory where ``mask`` (bool ``[*batch]``) is True alone; None: everywhere."""
        if mask is None:
            yield
            return
        before = [(module, module.memory()) for module in self.stateful()]
        yield
        for module, memory in before:
            module.put_back(memory, ~mask)

    def stateful(self) -> list[StatefulController]:
        """Return the controllers with memory in it."""
        return [module for module in self.modules() if isinstance(module, StatefulController)]


class StatefulController(Controller):
    """Base of controllers with memory, held slot by slot.

    :meth:`act` reads the memory with :meth:`state_for` and assigns the new one to ``state``. A slot
    that was reset finds its :meth:`initial_state` there. ``state`` is always replaced, never
    changed in place, so that a reference to an old state stays valid. It is part of
    ``state_dict``. Two environments, or an operator and a residual, need a controller each.
    """

    claimed: int | None = None
    """By whom, see :meth:`claim`. A number, which copies and other processes keep."""

    def __init__(self, in_keys: Sequence[NestedKey], out_key: NestedKey = BASE_ACTION) -> None:
        super().__init__(in_keys, out_key)
        self.state: State | None = None
        self._fresh: Tensor | None = None  # slots whose episode has not begun, bool [*batch]

    @abstractmethod
    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Return the state at the start of an episode, tensors ``[*batch, ...]``.

        Raises:
            NotImplementedError: If a subclass does not say.
        """
        raise missing(self, "initial_state")

    def state_for(self, tensordict: TensorDictBase) -> State:
        """Return the state of every slot; the initial one where an episode starts."""
        batch, fresh = tensordict.batch_size, self._fresh
        new = self.state is None or (fresh is not None and fresh.shape != batch)
        if new:
            fresh = torch.ones(batch, dtype=torch.bool, device=tensordict.device)
        # An exported graph has no branches: it computes the initial state at every step.
        if fresh is not None and (torch.compiler.is_exporting() or fresh.any()):
            start = self.initial_state(tensordict)
            # A copy even of a whole batch: an environment may change its tensors in place.
            self.state = merge(fresh, start, start if new else self.state)
            self._fresh = torch.zeros_like(fresh)
        assert self.state is not None
        return self.state

    def reset_state(self, mask: Tensor | None) -> None:
        """Forget the slots where ``mask`` (bool ``[*batch]``) is True; None: all."""
        if mask is None or self.state is None:
            self.state = self._fresh = None
        else:
            self._fresh = mask if self._fresh is None else self._fresh | mask

    def memory(self) -> Any:
        """Return what :meth:`put_back` needs."""
        return self.state, self._fresh

    def put_back(self, memory: Any, mask: Tensor) -> None:
        """Put :meth:`memory` back in the slots where ``mask`` (bool ``[*batch]``) is True."""
        state, fresh = memory
        if state is None:
            self.reset_state(mask)
            return
        self.state = merge(mask, state, self.state)
        if fresh is not None:
            self._fresh = merge(mask, fresh, self._fresh)

    def get_extra_state(self) -> dict[str, Any]:
        """Return the state for ``state_dict``."""
        return {"state": self.state, "fresh": self._fresh}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take the state from a ``state_dict``."""
        self.state, self._fresh = state["state"], state["fresh"]


def floating(value: Tensor) -> Tensor:
    """Return whole numbers in the default type, where factors of less than 1 do not count as 0."""
    return value if value.is_floating_point() else value.to(torch.get_default_dtype())


def _nearest(module: nn.Module) -> Iterator[Controller]:
    """Yield the controllers inside a module, but not those inside them."""
    for child in module.children():
        if isinstance(child, Controller):
            yield child
        else:
            yield from _nearest(child)


def clipped(action: Tensor, limit: Tensor | None) -> Tensor:
    """Return an action of floating point of at most this magnitude; None: as it is."""
    if limit is None:
        return action
    limit = limit.to(action.dtype)
    return torch.clamp(action, -limit, limit)
