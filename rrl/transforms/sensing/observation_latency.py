"""Delay, rate and dropout of a sensor, such as the camera tracker's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from rrl.transforms.base import RandomTransform
from rrl.transforms.masks import merge, reset_mask, step_mask

__all__ = ["ObservationLatency"]


class ObservationLatency(RandomTransform):
    """Delivers observations late: the tracker's measurement of ``steps`` control steps ago.

    The tracker measures at an episode's first step and then every ``update_interval`` steps; each
    of the later measurements is lost with probability ``dropout``, and in between the last one
    holds. The measurement is delivered ``steps`` control steps later; until then the first one is.
    All ``in_keys`` come from one tracker: they are measured and lost together.

    env -> policy: reads ``in_keys``, writes ``out_keys``.

    Args:
        in_keys: Observations ``[*batch, ...]`` of any dtype; may be nested.
        steps: Delay in control steps, not negative.
        update_interval: Control steps from one measurement to the next, at least 1.
        dropout: Probability that a measurement is lost, in [0, 1).
        seed: Seed of slot 0, slot i uses ``seed + i``. None: from torch's global generator at every
            reset of all slots. Workers of a ``ParallelEnv`` want None, or they all draw the same.
        out_keys: Where the delayed observations go; default: ``in_keys``.

    Raises:
        ValueError: If a number is out of its range, or keys are none or differ in number.
        KeyError: If an observation is missing.
        RuntimeError: If it is called outside an environment, where there is no order in time.

    """

    def __init__(
        self,
        in_keys: Sequence[NestedKey],
        steps: int = 1,
        update_interval: int = 1,
        dropout: float = 0.0,
        seed: int | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        if steps < 0 or steps != int(steps):
            raise ValueError(f"steps must be a whole number of at least 0, got {steps!r}.")
        if update_interval < 1 or update_interval != int(update_interval):
            raise ValueError(
                f"update_interval must be a whole number of at least 1, got {update_interval!r}."
            )
        if not 0.0 <= dropout < 1.0:
            raise ValueError(f"dropout must be a probability in [0, 1), got {dropout!r}.")
        super().__init__(
            seed=seed,
            stream=f"ObservationLatency/{in_keys}",
            in_keys=in_keys,
            out_keys=in_keys if out_keys is None else out_keys,
        )
        self.check_key_pairs()
        self.steps = int(steps)
        self.update_interval = int(update_interval)
        self.dropout = float(dropout)
        # One queue a key, oldest measurement first: (steps + 1, *batch, ...).
        self._queues: list[Tensor] | None = None
        self._age: Tensor | None = None  # control steps since the reset, int64 (*batch)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        batch = tensordict_reset.batch_size
        mask = reset_mask(tensordict, batch)
        self.start_episodes(batch, mask)
        fresh = [
            torch.stack([value] * (self.steps + 1))
            for value in (self.require(tensordict_reset, key) for key in self.in_keys)
        ]
        age = torch.zeros(batch, dtype=torch.int64, device=fresh[0].device)
        if mask is not None and self._queues is not None and self._age is not None:
            fresh = [_choose(mask, new, old) for new, old in zip(fresh, self._queues, strict=True)]
            age = torch.where(mask, age, self._age)
        self._queues, self._age = fresh, age
        return self._deliver(tensordict_reset)

    def _reset_on_native_autoreset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        raise RuntimeError(
            "ObservationLatency cannot delay an environment that resets itself within a step. "
            "Build it with native_autoreset=False."
        )

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        stepped = step_mask(tensordict, next_tensordict.batch_size)
        return self._measure(next_tensordict, stepped)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        raise RuntimeError(_NO_TIME)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Refuse: data outside an environment has no order in time."""
        raise RuntimeError(_NO_TIME)

    def _measure(self, tensordict: TensorDictBase, stepped: Tensor | None) -> TensorDictBase:
        queues, age = self._queues, self._age
        if queues is None or age is None:
            raise RuntimeError("ObservationLatency needs a reset before the first step.")
        age = age + 1
        measured = self._measured(age, tensordict.batch_size, stepped)
        renewed = []
        for key, queue in zip(self.in_keys, queues, strict=True):
            value = self.require(tensordict, key)
            if measured is not None:
                value = merge(measured, value, queue[-1])
            new = torch.cat([queue[1:], value.unsqueeze(0)])
            renewed.append(new if stepped is None else _choose(stepped, new, queue))
        self._queues = renewed
        self._age = age if stepped is None else torch.where(stepped, age, age - 1)
        return self._deliver(tensordict)

    def _measured(self, age: Tensor, batch: torch.Size, stepped: Tensor | None) -> Tensor | None:
        """Return which slots the tracker measures in now, bool ``[*batch]``; None: all."""
        measured = None if self.update_interval == 1 else age % self.update_interval == 0
        if self.dropout:
            # Drawn at every step, measured or not, so that the numbers do not depend on the
            # interval.
            draw = self.slots(batch).uniform((), stepped)
            kept = (draw >= self.dropout).reshape(batch).to(age.device)
            measured = kept if measured is None else measured & kept
        return measured

    def _deliver(self, tensordict: TensorDictBase) -> TensorDictBase:
        assert self._queues is not None
        for key, queue in zip(self.out_keys, self._queues, strict=True):
            tensordict.set(key, queue[0].clone())  # whoever changes it leaves the queue alone
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Give the delayed observations the specs of the originals."""
        for in_key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            observation_spec[out_key] = self.require_spec(observation_spec, in_key).clone()
        return observation_spec

    def get_extra_state(self) -> dict[str, Any]:
        """Return generators, queues and ages for ``state_dict``."""
        return {**super().get_extra_state(), "queues": self._queues, "age": self._age}

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Take generators, queues and ages from a ``state_dict``."""
        super().set_extra_state(state)
        self._queues, self._age = state["queues"], state["age"]


_NO_TIME = (
    "ObservationLatency delays what one environment observes from step to step; it cannot be "
    "called on data without an order in time, such as samples of a replay buffer. Append it to a "
    "TransformedEnv."
)


def _choose(mask: Tensor, where_true: Tensor, where_false: Tensor) -> Tensor:
    """Pick slot by slot from queues ``(steps + 1, *batch, ...)``."""
    trailing = where_true.ndim - 1 - mask.ndim
    return torch.where(mask.reshape(mask.shape + (1,) * trailing), where_true, where_false)
