"""The replay buffer, backed by the log of all transitions."""

from __future__ import annotations

import logging
from collections.abc import Container, Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase, unravel_key
from torchrl.data import LazyTensorStorage, RandomSampler, TensorDictReplayBuffer

from rrl.interventions import InterventionSampler, relabel_interventions
from rrl.keys import ACTION, EXCEEDS_AUTHORITY, INTERVENED, INTERVENTION
from rrl.n_step import STEPS, n_step_transitions

from ..settings import TrainerSettings
from .finite import require_finite
from .stored_images import StoredImages
from .transition_log import FOLDER, TransitionLog
from .unusable_records import named, put_neighbors

log = logging.getLogger(__name__)

CHUNK = 2**16
"""Records read at once when a buffer is filled from the log."""
OLDEST = 4096
"""So many of the oldest transitions name the oldest frame: more than there are environments."""
IMAGE_BATCHES = 4
"""Batches with images that are sampled at once: their images take more memory than all else."""
REWARDS = 100_000
"""As many say how large rewards are."""
FLAGS = (INTERVENED, EXCEEDS_AUTHORITY)
"""Of a transition, where an operator may take over; nothing that is learned from."""


def stored_keys(inputs: Iterable[NestedKey]) -> list[NestedKey]:
    """Return what is kept: the *policy's* action, before controller and disturbance.

    Args:
        inputs: What is kept of a state.
    """
    following = [*inputs, "reward", "done", "terminated"]
    return [*inputs, ACTION, *(unravel_key(("next", key)) for key in following)]


def as_stored(data: TensorDictBase, inputs: Iterable[NestedKey]) -> TensorDictBase:
    """Return what is kept of collected steps ``[E, T]``.

    Where an operator may take over, the action in ``data`` becomes the residual that was executed,
    and two flags are kept beside it (:func:`rrl.interventions.relabel_interventions`).

    Args:
        data: What the environment wrote.
        inputs: What is kept of a state.
    """
    operated = INTERVENTION in data["next"].keys()  # noqa: SIM118 - a TensorDict is no dict
    if operated:
        data = relabel_interventions(data)
    return data.select(*stored_keys(inputs), *(FLAGS if operated else ()))


class ReplayStore:
    """Stores every transition twice: in the buffer in memory and, first, in the log on disk.

    Images are stored beside them, each frame once (:class:`.stored_images.StoredImages`).

    Record ``n`` of the log is entry ``n % capacity`` of the buffer. A checkpoint therefore needs
    only a position in the log, whatever the buffer's size. What the log holds beyond that position
    after a crash is :attr:`pending`; there are two ways on from there:

    * the environment goes on from its saved state (simulation): it will make the same transitions
      again, bit for bit, and :meth:`set_pending_aside` keeps the old ones in a tail file that
      nothing reads;
    * it cannot (hardware): :meth:`recover` puts them into the buffer round by round, and the
      trainer learns from each as it did before the crash.

    Args:
        run_dir: The run's directory.
        capacity: Transitions that the buffer keeps.
        batch_size: Transitions of a batch.
        n_step: Rewards that a stored transition sums (:func:`rrl.n_step.n_step_transitions`).
        gamma: Their discount.
        device: Where the buffer lies.
        intervention_share: Part of every batch that comes from steps that an operator has taken
            over.

    Attributes:
        count: Transitions stored so far.
    """

    @classmethod
    def of(cls, settings: TrainerSettings, run_dir: Path, gamma: float) -> ReplayStore:
        """Return the store of a run with these settings and this discount."""
        return cls(
            run_dir,
            settings.kept_transitions,
            settings.batch_size,
            settings.n_step,
            gamma,
            settings.device,
            settings.intervention_share,
        )

    def __init__(
        self,
        run_dir: Path,
        capacity: int,
        batch_size: int,
        n_step: int = 1,
        gamma: float = 1.0,
        device: str = "cpu",
        intervention_share: float = 0.0,
    ) -> None:
        self.n_step, self.gamma = n_step, gamma
        self.capacity, self.batch_size = capacity, batch_size
        share = intervention_share
        self.replay = TensorDictReplayBuffer(
            storage=LazyTensorStorage(capacity, device=device),
            sampler=InterventionSampler(share) if share else RandomSampler(),
        )
        self.log = TransitionLog(run_dir / FOLDER)
        self.images = StoredImages(run_dir / FOLDER, device)
        self.keys: list[NestedKey] = []
        self.count = 0

    @property
    def pending(self) -> int:
        """Transitions in the log that are not in the buffer."""
        return self.log.count - self.count

    def portions(self, k: int) -> list[int]:
        """Divide ``k`` batches into how many of them should be sampled at once."""
        most = IMAGE_BATCHES if self.images else max(k, 1)
        return [min(most, k - first) for first in range(0, k, most)]

    def sample(self, k: int) -> TensorDictBase:
        """Draw ``k`` batches with replacement, ``[k, B]``."""
        data = self.replay.sample(k * self.batch_size).select(*self.keys)
        return self.images.get(data).reshape(k, self.batch_size)

    def newest(self, images: Container[NestedKey] | None = None) -> TensorDictBase:
        """Return all transitions in the buffer, ``[n]``, with images of some entries; None: all."""
        return self.images.get(self.replay[:].select(*self.keys), images)

    def rewards(self) -> TensorDictBase:
        """Return rewards from all over the buffer, ``[n]``, and of how many steps they are."""
        step = len(self.replay) // REWARDS + 1
        return self.replay[::step].select(("next", "reward"), STEPS, strict=False)

    def extend(self, data: TensorDictBase) -> TensorDictBase:
        """Store collected ``data`` [E, T]; when this returns it survives the process.

        Returns:
            What was stored, ``[T * E]`` in the order of time.

        Raises:
            FloatingPointError: If there are numbers in it that are not finite; nothing is stored.
            OSError: If the disk is full or gone.
        """
        data = self.images.put(data, self._last(len(data)) if self.images else None)
        if self.n_step > 1:
            data = n_step_transitions(data, self.n_step, self.gamma)
        transitions = data.transpose(0, 1).reshape(-1)  # in the order of time
        require_finite(dict(transitions.items(True, True)), "the environment gave")
        self.log.append(transitions)
        self._extend_buffer(transitions)
        self.count += len(transitions)
        if self.images and self.count > self.capacity:
            slots = range(self.count, self.count + min(OLDEST, self.capacity))
            self.images.forget(self._at(slots), on_disk=False)
        return transitions

    def set_pending_aside(self) -> None:
        """Move the pending transitions to a tail file."""
        number = self.pending
        tail = self.log.cut(self.count)
        self.images.cut()
        if tail is not None and number:
            log.warning(
                "%d transitions were stored after the checkpoint: the simulation makes them again, "
                "the old are in %s",
                number,
                tail,
            )

    def keep_whole_rounds(self, size: int, last: int | None = None) -> None:
        """Leave pending what :meth:`recover` can take in rounds of ``size``; set the rest aside.

        Args:
            size: Transitions of a round.
            last: Transition that no round may reach beyond; None: any may.
        """
        most = self.pending if last is None else min(self.pending, max(0, last - self.count))
        whole = most // size * size
        pending = self.log.read(self.count, self.count + whole)[0] if whole else TensorDict()
        while whole and not self.images.are_whole(pending[:whole]):
            whole -= size
        self.log.cut(self.count + whole)
        self.images.cut(pending[:whole] if whole else None)
        if whole:
            self.log.sync_all()  # whoever wrote them may not have: the next mark covers them
            self.images.sync_all()
            log.warning(
                "%d transitions were stored after the checkpoint; they are learned from again",
                whole,
            )

    def recover(self, size: int) -> TensorDictBase:
        """Put the next ``size`` pending transitions into the buffer, and return them."""
        return self._fill(self.count, self.count + size)

    def mark(self) -> dict[str, Any]:
        """Return where the buffer stands in the log, which is then on disk up to there."""
        self.log.sync()
        mark = {"count": self.count, "checksum": self.log.checksum(self.count)}
        return mark | ({"images": self.images.mark()} if self.images else {})

    def check(self, mark: Mapping[str, Any]) -> None:
        """Compare the log with a mark.

        Raises:
            ValueError: If the log does not reach the mark, or is not that of the run that made it.
        """
        count = mark["count"]
        if self.log.count < count:
            raise ValueError(f"{self.log.folder}: expected {count} records, got {self.log.count}")
        if self.log.checksum(count) != mark["checksum"]:
            raise ValueError(
                f"{self.log.folder}: expected record {count - 1} as the checkpoint knows it, "
                "got another"
            )
        self.images.check(mark.get("images", {}))

    def forget(self, first: int) -> None:
        """Remove what is on disk of transitions before ``first``, file by file."""
        self.log.forget(first)
        if self.images and first > 0:
            oldest, _ = self.log.read(first, min(first + OLDEST, self.log.count))
            self.images.forget(oldest, on_disk=True)

    def close(self) -> None:
        """Close the files that grow."""
        self.log.close()
        self.images.close()

    def state_dict(self) -> dict[str, Any]:
        """Return the position in the log; the transitions themselves are on disk already."""
        return {"count": self.count}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Fill the buffer from the log."""
        last = int(state["count"])
        first = max(0, last - self.capacity)
        self.replay.empty()
        writer = {"_cursor": first % self.capacity, "_write_count": first}
        self.replay.writer.load_state_dict(writer)
        self._fill(first, last, anew=True)

    def _last(self, n: int) -> TensorDictBase | None:
        """Return the newest ``n`` transitions, in the order of time, without their images."""
        return self._at(range(self.count - n, self.count)) if self.count >= n else None

    def _at(self, places: range) -> TensorDictBase:
        return self.replay[torch.tensor([place % self.capacity for place in places])]

    def _extend_buffer(self, transitions: TensorDictBase) -> None:
        self.keys = [key for key in transitions.keys(True, True) if key not in FLAGS]
        self.replay.extend(transitions)

    def _fill(self, first: int, last: int, anew: bool = False) -> TensorDict:
        """Put records into the buffer; return those of the last chunk."""
        transitions = TensorDict()
        for start in range(first, last, CHUNK):
            transitions, damaged = self.log.read(start, min(start + CHUNK, last))
            if damaged:
                self._replace(transitions, damaged, start)
            for key, bad in self.images.load(transitions, anew and start == first).items():
                log.warning(
                    "%d frames of %s are damaged on disk (%s, ...); each is replaced by the one "
                    "before",
                    *(len(bad), key, bad[0]),
                )
            self._extend_buffer(transitions)
        self.count = last
        return transitions

    def _replace(self, transitions: TensorDict, damaged: list[int], start: int) -> None:
        """Put the nearest sound transition in the place of each damaged one."""
        log.warning(
            "%d of the stored transitions are damaged on disk (records %s); each is replaced by "
            "its neighbor, all others are whole",
            len(damaged),
            named(damaged),
        )
        if not put_neighbors(transitions, {n - start for n in damaged}):
            raise ValueError(f"{self.log.folder}: expected a whole transition near record {start}")
