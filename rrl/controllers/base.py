"""What a controller is: a module from observation keys to the base action."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from rrl.keys import BASE_ACTION

__all__ = ["Controller", "StatefulController"]

State = dict[str, Tensor]


class Controller(TensorDictModuleBase):
    """Base of all controllers, pi_H(s_m) in the paper (section IV, equation of the superposition).

    A controller reads ``in_keys`` and writes one action to ``out_key``, in the action units of the
    environment it drives. A subclass implements :meth:`act`.

    Args:
        in_keys: Observation keys that :meth:`act` reads.
        out_key: Key that the action is written to.

    """

    def __init__(self, in_keys: Sequence[NestedKey], out_key: NestedKey = BASE_ACTION) -> None:
        super().__init__()
        self.in_keys = list(in_keys)
        self.out_keys = [out_key]

    @abstractmethod
    def act(self, tensordict: TensorDictBase) -> Tensor:
        """Compute the action of shape ``[*batch, n_act]``; leaves ``tensordict`` as it is.

        Raises:
            KeyError: If an observation key is missing.

        """

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the action to the out key of ``tensordict`` and returns it."""
        return tensordict.set(self.out_keys[0], self.act(tensordict))

    def read(self, tensordict: TensorDictBase, key: NestedKey) -> Tensor:
        """Return an entry, or raise a KeyError that says what there is instead."""
        value = tensordict.get(key, None)
        if value is None:
            available = sorted(map(str, tensordict.keys(True, True)))
            raise KeyError(
                f"{type(self).__name__} needs the key {key!r}, which the tensordict does not hold. "
                f"Available keys: {available}."
            )
        return value

    def fit(self, action_size: int) -> None:
        """Learn the size of the environment's action, n_act, before the first call."""

    def reset(self, mask: Tensor | None = None) -> None:
        """Start a new episode where ``mask`` (bool ``[*batch]``) is True; None: in all slots."""
        for module in self._stateful():
            module.reset_state(mask)

    def snapshot(self) -> list[State | None]:
        """Return the state of every stateful controller in here, for :meth:`restore`."""
        return [module.state for module in self._stateful()]

    def restore(self, snapshot: list[State | None], mask: Tensor) -> None:
        """Put back a snapshot in the slots where ``mask`` (bool ``[*batch]``) is True."""
        for module, state in zip(self._stateful(), snapshot, strict=True):
            if state is not None and module.state is not None:
                module.state = _merge(mask, state, module.state)

    def _stateful(self) -> list[StatefulController]:
        return [module for module in self.modules() if isinstance(module, StatefulController)]


class StatefulController(Controller):
    """A controller with memory, held slot by slot.

    ``state`` maps names to tensors ``[*batch, ...]``. It is allocated at first use and always
    replaced, never changed in place, so that a reference to an old state stays valid. It is part of
    ``state_dict``.
    """

    def __init__(self, in_keys: Sequence[NestedKey], out_key: NestedKey = BASE_ACTION) -> None:
        super().__init__(in_keys, out_key)
        self.state: State | None = None

    @abstractmethod
    def initial_state(self, tensordict: TensorDictBase) -> State:
        """Return the state at the start of an episode, each tensor ``[*batch, ...]``."""

    def state_for(self, tensordict: TensorDictBase) -> State:
        """Return the state, allocated for the batch size of ``tensordict`` if need be."""
        state = self.state
        batch = tensordict.batch_size
        if state is None or next(iter(state.values())).shape[: len(batch)] != batch:
            state = self.state = self.initial_state(tensordict)
        return state

    def reset_state(self, mask: Tensor | None) -> None:
        """Forget the slots where ``mask`` is True (None: all)."""
        if mask is None or self.state is None:
            self.state = None
        else:
            fresh = {name: torch.zeros_like(value) for name, value in self.state.items()}
            self.state = _merge(mask, fresh, self.state)

    def get_extra_state(self) -> dict[str, Any]:
        """Return the state for ``state_dict``."""
        return {} if self.state is None else dict(self.state)

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take the state from a ``state_dict``."""
        self.state = dict(state) or None


def _merge(mask: Tensor, where_true: State, where_false: State) -> State:
    return {
        name: torch.where(mask.reshape(mask.shape + (1,) * (value.ndim - mask.ndim)), value, other)
        for (name, value), other in zip(where_true.items(), where_false.values(), strict=True)
    }
