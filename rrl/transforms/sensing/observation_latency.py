"""Delay, rate and dropout of a sensor, such as the camera tracker's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from rrl.checks import check_share, check_whole
from rrl.slot_masks import merge
from rrl.transforms.base import Mask, Memory
from rrl.transforms.sensing.fault import SensingFault

_AGE = "age"


class ObservationLatency(SensingFault):
    """Observations delivered late: the tracker's measurement of ``steps`` control steps ago.

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
            reset of all slots. Workers of a ``ParallelEnv`` need None, or they all draw the same.
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
        super().__init__(in_keys, out_keys, seed)
        self.steps = check_whole("steps", steps, 0)
        self.update_interval = check_whole("update_interval", update_interval, 1)
        self.dropout = check_share("dropout", dropout, below_one=True)

    def silence(self) -> None:
        """Deliver every observation at once."""
        self.steps, self.update_interval, self.dropout = 0, 1, 0.0

    def _first(self, td: TensorDictBase, mask: Mask) -> Memory:
        batch = td.batch_size
        memory = {
            name: torch.stack([value] * (self.steps + 1), len(batch))
            for name, value in self._read(td).items()
        }
        # Control steps since the reset, int64 (*batch)
        return memory | {_AGE: torch.zeros(batch, dtype=torch.int64, device=td.device)}

    def _advance(self, td: TensorDictBase, next_td: TensorDictBase, mask: Mask) -> Memory:
        memory = {_AGE: self.recall(_AGE) + 1}
        measured = self._measured(memory[_AGE], mask)
        dim = next_td.batch_dims
        for name, value in self._read(next_td).items():
            queue = self.memory[name]
            if measured is not None:
                value = merge(measured, value, queue.select(dim, -1))
            late = queue.narrow(dim, 1, self.steps)
            memory[name] = torch.cat([late, value.unsqueeze(dim)], dim)
        return memory

    def _measured(self, age: Tensor, stepped: Mask) -> Mask:
        """Return which slots the tracker measures in now, bool ``[*batch]``; None: all."""
        measured = None if self.update_interval == 1 else age % self.update_interval == 0
        if self.dropout:
            # Drawn at every step, measured or not, so that the numbers do not depend on the
            # interval.
            kept = (self.generators.uniform(age.shape, mask=stepped) >= self.dropout).to(age.device)
            measured = kept if measured is None else measured & kept
        return measured

    def _outputs(self) -> Iterable[Tensor]:
        dim = self.memory[_AGE].ndim
        return [self.memory[str(number)].select(dim, 0) for number in range(len(self.in_keys))]
