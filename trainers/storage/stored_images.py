"""Images of transitions: each frame is stored once, and transitions name it by its number."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from pathlib import Path

import numpy as np
import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from torch import Tensor

from rrl.inputs import channels_of

from .frame_log import FrameLog
from .frame_memory import FrameMemory

Recent = list[dict[bytes, int]]
"""Of each environment the frames that it showed last, and their numbers."""


class StoredImages:
    """The image entries of a run, whatever else its transitions hold.

    An image is one frame, or as many as were stacked: 3 channels are a frame where the channels can
    be counted by threes, else each is one. A frame that an environment showed in the observation
    before is not stored again: what comes after a step is what the next one starts from, stacked
    frames move on by one, and a camera that has stopped shows what it did. Frames are compared byte
    by byte, so whatever comes is given back as it was.

    Without images everything is left as it is.

    Args:
        folder: Of the transitions.
        device: Where frames in memory lie.
    """

    def __init__(self, folder: Path, device: str = "cpu") -> None:
        self._folder, self._device = folder, device
        self._entries: dict[NestedKey, _Entry] = {}
        for path in FrameLog.folders(folder):
            self._add(FrameLog(path))

    def __bool__(self) -> bool:
        return bool(self._entries)

    def put(self, data: TensorDictBase, before: TensorDictBase | None) -> TensorDictBase:
        """Store the images of collected data.

        Args:
            data: ``[E, T]``, in the order of time; left as it is.
            before: The transitions ``[E]`` before them, with numbers; None: there are none.

        Returns:
            The same with numbers, ``[E, T, frames]``, in the place of images.

        Raises:
            OSError: If they cannot be written.
        """
        for key, value in data.exclude("next").items(True, True):
            is_image = channels_of(value.shape[2:], value.dtype) != "none"
            if is_image and key not in self._entries:
                self._create(key, value.shape[2:])
        if not self._entries:
            return data
        out = data.copy()
        for key, entry in self._entries.items():
            numbers = entry.put(
                data[key], data[_next(key)], None if before is None else before[_next(key)]
            )
            out[key], out[_next(key)] = numbers
        return out

    def get(
        self, transitions: TensorDictBase, keys: Container[NestedKey] | None = None
    ) -> TensorDictBase:
        """Return transitions ``[n]`` with images in the place of numbers.

        Args:
            transitions: With numbers.
            keys: The entries that are wanted, which take memory; others are left out. None: all.
        """
        if not self._entries:
            return transitions
        out = transitions.copy()
        for key, entry in self._entries.items():
            for place in (key, _next(key)):
                if keys is None or key in keys:
                    out[place] = entry.get(transitions[place])
                else:
                    del out[place]
        return out

    def load(self, transitions: TensorDictBase, anew: bool) -> dict[NestedKey, list[int]]:
        """Take the frames of transitions ``[n]`` from disk, those that memory does not have.

        Args:
            transitions: With numbers, in the order of time.
            anew: Whether memory holds nothing yet that counts.

        Returns:
            Damaged frames by entry; the one before stands in the place of each.
        """
        damaged = {}
        for key, entry in self._entries.items():
            first, last = _span(transitions, key)
            if bad := entry.load(first, last, anew):
                damaged[key] = bad
        return damaged

    def are_whole(self, transitions: TensorDictBase) -> bool:
        """Whether the disk has all frames of transitions."""
        return all(_span(transitions, k)[1] <= e.log.count for k, e in self._entries.items())

    def cut(self, pending: TensorDictBase | None = None) -> None:
        """Set the frames aside that neither memory nor the transitions that are to come name."""
        for key, entry in self._entries.items():
            last = 0 if pending is None or not len(pending) else _span(pending, key)[1]
            entry.log.cut(max(entry.memory.end, last))

    def forget(self, oldest: TensorDictBase, on_disk: bool) -> None:
        """Forget the frames before those of transitions, of which all others are younger."""
        for key, entry in self._entries.items():
            (entry.log if on_disk else entry.memory).forget(_span(oldest, key)[0])

    def sync_all(self) -> None:
        """Fsync every frame, whichever process has stored it."""
        for entry in self._entries.values():
            entry.log.sync_all()

    def mark(self) -> dict[str, list[int]]:
        """Return how many frames each log has, and a checksum of them; they are then on disk."""
        marks = {}
        for entry in self._entries.values():
            entry.log.sync()
            count = entry.log.count
            marks[entry.log.folder.name] = [count, entry.log.checksum(count)]
        return marks

    def check(self, marks: Mapping[str, list[int]]) -> None:
        """Compare the logs with a mark.

        Raises:
            ValueError: If a log does not reach it, or is another one.
        """
        logs = {entry.log.folder.name: entry.log for entry in self._entries.values()}
        for name, (count, checksum) in marks.items():
            folder = self._folder / name
            found = logs[name].count if name in logs else 0
            if found < count:
                raise ValueError(f"{folder}: expected {count} frames, got {found}")
            if logs[name].checksum(count) != checksum:
                raise ValueError(f"{folder}: expected frame {count - 1} as the checkpoint knows it")

    def close(self) -> None:
        """Close the files that grow."""
        for entry in self._entries.values():
            entry.log.close()

    def _create(self, key: NestedKey, shape: torch.Size) -> None:
        folder = self._folder / f"images_{len(self._entries):02d}"
        names = [key] if isinstance(key, str) else list(key)
        frame = _frames(torch.zeros(1, *shape), shape).shape[2:]
        self._add(FrameLog.create(folder, names, shape, frame))

    def _add(self, log: FrameLog) -> None:
        self._entries[unravel_key(log.key)] = _Entry(log, FrameMemory(self._device))


class _Entry:
    """One image entry."""

    def __init__(self, log: FrameLog, memory: FrameMemory) -> None:
        self.log, self.memory = log, memory
        self._recent: Recent | None = None

    def put(self, now: Tensor, then: Tensor, before: Tensor | None) -> tuple[Tensor, Tensor]:
        """Store images ``[E, T, *shape]``; return their numbers ``[E, T, frames]``."""
        pictures = [_frames(x.cpu().flatten(0, 1), self.log.image) for x in (now, then)]
        slots, steps = now.shape[:2]
        count = pictures[0].shape[1]
        numbers = np.empty((2, slots, steps, count), np.int64)
        recent = self._recent or self._recall(before, slots)
        new: list[np.ndarray] = []
        for step in range(steps):
            for slot in range(slots):
                for which, picture in enumerate(pictures):
                    shown: dict[bytes, int] = {}
                    for i, frame in enumerate(picture[slot * steps + step].numpy()):
                        data = frame.tobytes()
                        number = shown.get(data, recent[slot].get(data, -1))
                        if number < 0:
                            number = self.log.count + len(new)
                            new.append(frame)
                        shown[data] = numbers[which, slot, step, i] = number
                    recent[slot] = shown
        self._recent = None
        if new:
            frames = np.stack(new)
            self.log.append(frames)
            self.memory.append(torch.from_numpy(frames))
        self._recent = recent
        first, second = torch.from_numpy(numbers)
        return first, second

    def get(self, numbers: Tensor) -> Tensor:
        """Return images ``[n, *shape]`` of numbers ``[n, frames]``."""
        return _image(self.memory.get(numbers.flatten().tolist()), len(numbers), self.log.image)

    def load(self, first: int, last: int, anew: bool) -> list[int]:
        if anew:
            self.memory.start(first)
            self._recent = None
        frames, damaged = self.log.read(self.memory.end, max(last, self.memory.end))
        self.memory.append(torch.from_numpy(frames))
        return damaged

    def _recall(self, before: Tensor | None, slots: int) -> Recent:
        """Return what was shown last, from the numbers ``[E, frames]`` of the last transitions."""
        if before is None:
            return [{} for _ in range(slots)]
        return [
            {self.memory.get([n])[0].cpu().numpy().tobytes(): n for n in numbers}
            for numbers in before.tolist()
        ]


def _frames(images: Tensor, shape: Iterable[int]) -> Tensor:
    """Cut images ``[n, *shape]`` into frames ``[n, frames, C, H, W]``."""
    if channels_of(tuple(shape), torch.uint8) == "last":
        images = images.movedim(-1, -3)
    planes = images.reshape(len(images), -1, *images.shape[-2:])
    channels = 3 if planes.shape[1] % 3 == 0 else 1
    return planes.reshape(len(images), -1, channels, *planes.shape[-2:]).contiguous()


def _image(frames: Tensor, n: int, shape: tuple[int, ...]) -> Tensor:
    """Put images ``[n, *shape]`` together from frames ``[n * frames, C, H, W]``."""
    if channels_of(shape, torch.uint8) == "first":
        return frames.reshape(n, *shape)
    *stacked, height, width, channels = shape
    return frames.reshape(n, *stacked, channels, height, width).movedim(-3, -1)


def _next(key: NestedKey) -> NestedKey:
    return unravel_key(("next", key))


def _span(transitions: TensorDictBase, key: NestedKey) -> tuple[int, int]:
    """Return the least number that transitions name, and the one after the largest."""
    numbers = torch.stack([transitions[key], transitions[_next(key)]])
    return int(numbers.min()), int(numbers.max()) + 1
