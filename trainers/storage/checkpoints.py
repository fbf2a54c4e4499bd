"""Saving a run and taking it up again.

Layout, below the run's directory::

    config.yaml                      the resolved configuration
    metrics.csv                      every metric so far
    wandb_id                         identity of the W&B run
    transitions/                     every transition; see :mod:`.transition_log`
    checkpoints/
        checkpoint-000000005000/     made under a temporary name, synced to disk, then renamed
            manifest.json            TorchRL's manifest
            seal.json                configuration, position in transitions/, SHA-256 of every file
            components/
                agent/               parameters, targets, optimizers, update counter
                collection/          physics, transforms, exploration, what the policy sees next;
                                     where collection overlaps, the parameters to act with
                constraints/         multipliers
                clock/               seconds so far
                handed_over/         the agent when its policy was accepted; what tests have used up
                generator/           what sampling and updates draw from
                progress/            counters
                replay/              position in transitions/
                rng/                 global generators of Python, NumPy and torch
        checkpoint-000000004000.torn/  one whose checksums were wrong; nothing reads it

Loading executes no code: tensors are read as weights only, the rest is JSON and raw memory.
"""

from __future__ import annotations

import io
import logging
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torchrl.checkpoint import Checkpoint, CheckpointAdapter

from ..generators import Generators
from .files import check_seal, fsync, lock, read_note, seal
from .plain_state import from_plain, to_plain
from .run_files import CHECKPOINTS

log = logging.getLogger(__name__)

Note = dict[str, Any]
"""What is sealed with a checkpoint: ``env_steps``, ``transitions`` (a position), ``config``,
``interface`` (what the learner reads and says), ``lengths`` (those that the run has derived)."""

PREFIX, TORN = "checkpoint-", ".torn"


class Checkpoints:
    """The checkpoints of one run.

    Args:
        run_dir: The run's directory.
        keep: How many checkpoints stay.
        components: What to save, by name; anything with ``state_dict`` and ``load_state_dict``.
    """

    def __init__(self, run_dir: Path, keep: int, components: Mapping[str, Any]) -> None:
        self._folder, self._keep = run_dir / CHECKPOINTS, keep
        self._lock: int | None = None
        self._checkpoint = _of({**components, "rng": Generators()})

    def claim(self) -> None:
        """Keep other processes from training here, until :meth:`release` or the process's end.

        Raises:
            BlockingIOError: If another process does.
        """
        if self._lock is None:
            self._lock = lock(self._folder.parent)

    def release(self) -> None:
        """Let others train in the run's directory."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def save(self, env_steps: int, note: Note) -> Path:
        """Write a checkpoint and drop those beyond ``keep``; a kill leaves the ones before.

        Raises:
            OSError: If it cannot be written.
        """
        destination = self._folder / f"{PREFIX}{env_steps:012d}"
        if destination.exists():  # the same step of the same run: the same state
            return destination
        self._folder.mkdir(parents=True, exist_ok=True)
        self._sweep()
        stage = self._folder / f".{destination.name}"
        try:
            self._checkpoint.save(stage)
            seal(stage, {"env_steps": env_steps, **note})
        except (OSError, RuntimeError) as error:  # the second: what is read back is not whole
            shutil.rmtree(stage, ignore_errors=True)
            raise OSError(f"cannot write checkpoint {destination}: {error}") from error
        stage.rename(destination)
        fsync(self._folder)
        for path in _found(self._folder)[: -self._keep]:
            path.rename(path.with_name(f".{path.name}"))
        self._sweep()
        return destination

    def exist(self) -> bool:
        """Whether the run has a checkpoint, whole or not."""
        return bool(_found(self._folder))

    def load(self, path: Path, torn: Sequence[Path] = ()) -> None:
        """Restore every component from ``path``; rename the ``torn`` ones."""
        self._checkpoint.load(path)
        for other in torn:
            aside = other.with_name(other.name + TORN)
            shutil.rmtree(aside, ignore_errors=True)
            other.rename(aside)
        self._sweep()

    def oldest_transition(self) -> int:
        """Return the oldest checkpoint's position in the log; 0 while that cannot be told."""
        try:
            return int(read_note(_found(self._folder)[0])["transitions"]["count"])
        except (IndexError, ValueError):
            return 0

    def _sweep(self) -> None:
        """Remove what a kill has left half written or half deleted."""
        for path in self._folder.glob(".*"):
            shutil.rmtree(path, ignore_errors=True)


def newest_whole(
    run_dir: Path, accept: Callable[[Note], None] = lambda note: None
) -> tuple[Path, Note, list[Path]]:
    """Return the newest whole checkpoint of a run, its note, and the newer ones that are torn.

    Args:
        run_dir: The run's directory.
        accept: Called with a checkpoint's note; raises a ValueError if it does not fit the run.

    Raises:
        FileNotFoundError: If the run has none; the message says where it was looked for.
        ValueError: If none is whole.
    """
    folder = run_dir / CHECKPOINTS
    torn: list[Path] = []
    reasons = []
    for path in reversed(_found(folder)):
        try:
            note = check_seal(path)
            accept(note)
        except ValueError as error:
            torn.append(path)
            reasons.append(f"{path.name}: {error}")
            continue
        for reason in reasons:
            log.warning("torn checkpoint %s; going back to %s", reason, path.name)
        return path, note, torn
    if reasons:
        raise ValueError(
            f"{folder}: expected a checkpoint that is whole, got none:\n"
            + "\n".join(f"  {reason}" for reason in reasons)
        )
    raise FileNotFoundError(
        f"{folder}: expected the directory of a run that saved a checkpoint, got one without any"
    )


def saved_note(run_dir: Path) -> Note:
    """Return the note of a run's newest checkpoint that can be read; an empty one without any."""
    for path in reversed(_found(run_dir / CHECKPOINTS)):
        try:
            return read_note(path)
        except ValueError:
            continue
    return {}


def load_components(run_dir: Path, components: Mapping[str, Any]) -> tuple[Path, int]:
    """Restore some components from a run's newest whole checkpoint, for evaluation.

    Args:
        run_dir: The run's directory.
        components: What to restore, by the name that it was saved under.

    Returns:
        The checkpoint, and the environment steps at which it was made.
    """
    path, note, _ = newest_whole(run_dir)
    _of(components).load(path, components=list(components))
    return path, int(note["env_steps"])


def _found(folder: Path) -> list[Path]:
    """Published checkpoints, oldest first."""
    return sorted(p for p in folder.glob(f"{PREFIX}*") if p.is_dir() and not p.name.endswith(TORN))


def _of(components: Mapping[str, Any]) -> Checkpoint:
    """Return what saves and restores components, by name."""
    checkpoint = Checkpoint()
    for name, component in components.items():
        checkpoint.register(name, component, adapter=_WeightsOnly())
    return checkpoint


class _WeightsOnly(CheckpointAdapter):
    """One file a component, read by PyTorch's weights-only unpickler.

    TorchRL's own adapter would also read formats that unpickle objects, if it found any.
    """

    adapter_id = "rrl.weights_only"
    FILE = "state.pt"

    def save(self, component: Any, path: Path, **_: Any) -> Any:
        path.mkdir(parents=True)
        state = io.BytesIO()  # PyTorch's own writer does not say that a disk is full
        torch.save(to_plain(component.state_dict(), path.name), state)
        (path / self.FILE).write_bytes(state.getbuffer())
        torch.load(path / self.FILE, map_location="cpu", weights_only=True)  # or it does not count

    def load(self, component: Any, path: Path, **_: Any) -> Any:
        state = torch.load(path / self.FILE, map_location="cpu", weights_only=True)
        component.load_state_dict(from_plain(state))
