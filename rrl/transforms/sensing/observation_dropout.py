"""Outages of a sensor, such as frames that a camera loses."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import NestedKey, TensorDictBase

from rrl.checks import check_share, check_whole
from rrl.slot_masks import merge
from rrl.transforms.base import Mask, Memory
from rrl.transforms.sensing.fault import SensingFault

_LEFT = "left"


class ObservationDropout(SensingFault):
    """Observations that are lost for some steps, in which the last one stays.

    Outside an outage one begins in every control step with a probability, the first step of an
    episode excepted. All ``in_keys`` come from one sensor: they are lost together.

    env -> policy: reads ``in_keys``, writes ``out_keys``.

    Args:
        in_keys: Observations ``[*batch, ...]`` of any dtype, such as images; may be nested.
        probability: That an outage begins in a step, in [0, 1).
        steps: Control steps that an outage lasts, at least 1.
        seed: Seed of slot 0, slot i uses ``seed + i``. None: from torch's global generator at every
            reset of all slots. Workers of a ``ParallelEnv`` need None, or they all draw the same.
        out_keys: Where the observations go; default: ``in_keys``.

    Raises:
        ValueError: If a number is out of its range, or keys are none or differ in number.
        KeyError: If an observation is missing.
        RuntimeError: If it is called outside an environment, where there is no order in time.
    """

    def __init__(
        self,
        in_keys: Sequence[NestedKey],
        probability: float,
        steps: int = 1,
        seed: int | None = None,
        out_keys: Sequence[NestedKey] | None = None,
    ) -> None:
        super().__init__(in_keys, out_keys, seed)
        self.written = [str(number) for number in range(len(self.in_keys))]
        self.probability = check_share("probability", probability, below_one=True)
        self.steps = check_whole("steps", steps, 1)

    def silence(self) -> None:
        """Lose nothing."""
        self.probability = 0.0

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        # Steps of an outage that are left, int64 (*batch)
        left = torch.zeros(td.batch_size, dtype=torch.int64, device=td.device)
        # Copies: an environment may change its own tensors in place.
        seen = {name: value.clone() for name, value in self._read(td).items()}
        return seen | {_LEFT: left}

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        left, seen = self.recall(_LEFT), self._read(next_td)
        if not self.probability:
            return seen | {_LEFT: left}
        # At every step: the numbers do not depend on outages.
        draw = self.generators.uniform(next_td.batch_size, mask=mask)
        begins = (draw < self.probability).to(left.device)
        left = torch.where(left > 0, left, begins * self.steps)
        held = {name: self.memory[name] for name in seen}
        return merge(left > 0, held, seen) | {_LEFT: (left - 1).clamp_min(0)}
