"""The replay buffer, backed by the log of all transitions."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from rrl.keys import ACTION, OBSERVATION
from rrl.n_step import STEPS, n_step_transitions
from rrl.replay import StackedSampler

from .finite import require_finite
from .transition_log import FOLDER, TransitionLog

log = logging.getLogger(__name__)

STORED = (
    OBSERVATION,
    ACTION,
    ("next", OBSERVATION),
    ("next", "reward"),
    ("next", "done"),
    ("next", "terminated"),
)
"""What the replay buffer keeps: the *policy's* action, before controller and disturbance (algorithm 1)."""

CHUNK = 2**16
"""Records read at once when a buffer is filled from the log."""


class ReplayStore:
    """Stores every transition twice: in the buffer in memory and, first, in the log on disk.

    Record ``n`` of the log is entry ``n % capacity`` of the buffer. A checkpoint therefore needs only a position in the
    log, whatever the buffer's size. What the log holds beyond that position after a crash is :attr:`pending`; there
    are two ways on from there:

    * the environment goes on from its saved state (simulation): it will make the same transitions again, bit for bit,
      and :meth:`set_pending_aside` keeps the old ones in a tail file that nothing reads;
    * it cannot (hardware): :meth:`recover` puts them into the buffer round by round, and the trainer learns from each
      as it did before the crash.

    Args:
        run_dir: the run's directory.
        sampler: draws every seed's batches; tells the number of seeds whose transitions are interleaved.
        capacity: transitions that the buffer keeps per seed.
        n_step, gamma: rewards that a stored transition sums, and their discount; see
            :func:`rrl.n_step.n_step_transitions`.

    Attributes:
        count: transitions stored so far, of all seeds.
    """

    def __init__(
        self,
        run_dir: Path,
        sampler: StackedSampler,
        capacity: int,
        n_step: int = 1,
        gamma: float = 1.0,
    ) -> None:
        self.n_step, self.gamma = n_step, gamma
        self.keys: tuple[NestedKey, ...] = (*STORED, STEPS) if n_step > 1 else STORED
        self.sampler, self.num_seeds = sampler, sampler.num_seeds
        self.capacity = capacity * sampler.num_seeds
        self.replay = TensorDictReplayBuffer(
            storage=LazyTensorStorage(self.capacity), sampler=sampler
        )
        self.log = TransitionLog(run_dir / FOLDER)
        self.count = 0

    @property
    def pending(self) -> int:
        """Transitions in the log that are not in the buffer."""
        return self.log.count - self.count

    def sample(self, k: int) -> TensorDictBase:
        """Draw ``k`` batches for every seed, ``[k, S, B]``."""
        shape = k, self.num_seeds, self.sampler.batch_size
        return self.replay.sample(k * shape[1] * shape[2]).select(*self.keys).reshape(shape)

    def interleave(self, data: TensorDictBase) -> TensorDictBase:
        """What is stored of collected ``data``, ``[S * E, T]`` to ``[E * T * S]``; see :class:`StackedSampler`."""
        stored = data.select(*STORED)
        if self.n_step > 1:
            stored = n_step_transitions(stored, self.n_step, self.gamma)
        stored = stored.reshape(self.num_seeds, -1)
        return stored.transpose(0, 1).reshape(-1)

    def extend(self, data: TensorDictBase) -> None:
        """Store collected ``data`` ``[S * E, T]``; when this returns it survives the death of the process.

        Raises:
            FloatingPointError: if there are numbers in it that are not finite; nothing is stored.
            OSError: if the disk is full or gone.
        """
        transitions = self.interleave(data)
        require_finite(transitions.flatten_keys("/"), "the environment gave")
        self.log.append(transitions)
        self.replay.extend(transitions)
        self.count += len(transitions)

    def set_pending_aside(self) -> None:
        """Move the pending transitions to a tail file."""
        number = self.pending
        tail = self.log.cut(self.count)
        if tail is not None and number:
            log.warning(
                "%d transitions were stored after the checkpoint: the simulation makes them again, the old are in %s",
                number,
                tail,
            )

    def keep_whole_rounds(self, size: int) -> None:
        """Leave pending what :meth:`recover` can take in rounds of ``size``; set the rest aside."""
        whole = self.pending // size * size
        self.log.cut(self.count + whole)
        if whole:
            log.warning(
                "%d transitions were stored after the checkpoint; they are learned from again",
                whole,
            )

    def recover(self, size: int) -> None:
        """Put the next ``size`` pending transitions into the buffer."""
        self._fill(self.count, self.count + size)

    def mark(self) -> dict[str, int]:
        """Where the buffer stands in the log, to be kept with a checkpoint; the disk holds the log up to there."""
        self.log.sync()
        return {"count": self.count, "checksum": self.log.checksum(self.count)}

    def check(self, mark: Mapping[str, int]) -> None:
        """Raise a ValueError unless the log reaches ``mark`` and is the log of the run that made it."""
        count = mark["count"]
        if self.log.count < count:
            raise ValueError(
                f"{self.log.folder} ends at record {self.log.count}, the checkpoint needs {count}"
            )
        if self.log.checksum(count) != mark["checksum"]:
            raise ValueError(
                f"{self.log.folder}: record {count - 1} is not the one that the checkpoint was made with"
            )

    def state_dict(self) -> dict[str, Any]:
        """The position in the log; the transitions themselves are on disk already."""
        return {"count": self.count}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Fill the buffer from the log."""
        last = int(state["count"])
        first = max(0, last - self.capacity)
        self.replay.empty()
        self.replay.writer.load_state_dict(
            {"_cursor": first % self.capacity, "_write_count": first}
        )
        self._fill(first, last)

    def _fill(self, first: int, last: int) -> None:
        for start in range(first, last, CHUNK):
            transitions, damaged = self.log.read(start, min(start + CHUNK, last))
            if damaged:
                self._replace(transitions, damaged, start)
            self.replay.extend(transitions)
        self.count = last

    def _replace(self, transitions: TensorDict, damaged: list[int], start: int) -> None:
        """Put the same seed's nearest sound transition in the place of each damaged one."""
        log.warning(
            "%d of the stored transitions are damaged on disk (records %s); each is replaced by its neighbour of the "
            "same seed, all others are whole",
            len(damaged),
            ", ".join(map(str, damaged[:5])) + (", ..." if len(damaged) > 5 else ""),
        )
        bad = {n - start for n in damaged}
        for i in bad:
            same_seed = torch.arange(i % self.num_seeds, len(transitions), self.num_seeds).tolist()
            sound = [j for j in same_seed if j not in bad]
            if not sound:
                raise ValueError(f"{self.log.folder}: no whole transition near record {start + i}")
            transitions[i] = transitions[min(sound, key=lambda j: abs(j - i))]
