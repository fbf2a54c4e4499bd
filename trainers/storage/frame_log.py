"""Every frame of a camera on disk, once and compressed, in files that only grow.

Layout, below the run's directory::

    transitions/
        images_00/                   of one observation entry
            image.json               {"version", "key", "image", "frame", "frames_per_file"}
            frames_000000.bin        frames 0 .. S - 1, compressed, one after the other
            frames_000001.bin        frames S .. 2S - 1; the last file is the one that grows
            index/                   where each lies: as :mod:`.transition_log` lays out records
            tail_000000005000_000.bin  frames from 5000 on that a resumed run made anew

    one record of the index:  crc32 of the bytes | kind | size | start

Transitions name a frame by its number. A frame is bytes ``[C, H, W]``, compressed by zlib as it is
(kind 0) or as the difference from the frame before it (kind 1), whichever is shorter; every 32nd
stands for itself. The index has a checksum a record for itself, and one for the frame's bytes.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from .files import cut_files, fsync, number_of, write_at, write_atomically, write_tail
from .transition_log import TransitionLog

Frames = NDArray[np.uint8]
"""``[n, C, H, W]``."""

ABOUT, INDEX = "image.json", "index"
VERSION = 1
FRAMES_PER_FILE = 1024
WHOLE_EVERY = 32
GOOD = 8
"""A difference that is compressed to this part of a frame is kept without trying the frame."""
LEVEL = 6
WHOLE, DIFFERENCE = 0, 1


class FrameLog:
    """The frames of one observation entry, numbered from 0 in the order in which they were stored.

    Args:
        folder: Where the files lie; :meth:`create` makes it.

    Raises:
        ValueError: If ``image.json`` is missing, of another version or unreadable.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._read_about()
        self._index = TransitionLog(folder / INDEX)
        self._last: Frames | None = None
        self._unsynced: set[Path] = set()

    @classmethod
    def create(
        cls, folder: Path, key: Sequence[str], image: Sequence[int], frame: Sequence[int]
    ) -> FrameLog:
        """Make a log without frames.

        Args:
            folder: Where the files will lie.
            key: The entry, its names as a list.
            image: Shape of the entry's images.
            frame: Shape of a frame ``[C, H, W]``.
        """
        about = {"version": VERSION, "key": list(key), "image": list(image)}
        about |= {"frame": list(frame), "frames_per_file": FRAMES_PER_FILE}
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / ABOUT, json.dumps(about, indent=1) + "\n")
        return cls(folder)

    @staticmethod
    def folders(parent: Path) -> list[Path]:
        """Return where logs lie; a folder without ``image.json`` is what a kill has left."""
        return sorted(path.parent for path in parent.glob(f"images_*/{ABOUT}"))

    @property
    def count(self) -> int:
        """Number of whole frames."""
        return self._index.count

    def checksum(self, count: int) -> int:
        """A checksum that stands for the first ``count`` frames."""
        return self._index.checksum(count)

    def append(self, frames: Frames) -> None:
        """Write frames ``[n, C, H, W]`` behind the last one.

        Raises:
            OSError: If they cannot be written; what was there before stays whole.
        """
        while len(frames):
            file, at = divmod(self.count, self._per_file)
            part, frames = np.split(frames, [self._per_file - at])
            start, records = self._end() if at else 0, list[tuple[int, int, bytes]]()
            last = self._last_frame()
            for number, frame in enumerate(part, self.count):
                kind, data = _compress(frame, None if number % WHOLE_EVERY == 0 else last)
                records.append((kind, zlib.crc32(data), data))
                last = frame
            self._write(b"".join(data for _, _, data in records), file, start)
            sizes = torch.tensor([len(data) for _, _, data in records])
            entries = {
                "start": start + sizes.cumsum(0) - sizes,
                "size": sizes,
                "kind": torch.tensor([kind for kind, _, _ in records], dtype=torch.uint8),
                "crc": torch.tensor([crc for _, crc, _ in records]),
            }
            self._index.append(TensorDict(entries, [len(records)]))
            self._last = last

    def read(self, first: int, last: int) -> tuple[Frames, list[int]]:
        """Return frames ``first .. last - 1``, and which of them are damaged.

        In the place of a damaged frame stands the one before it.

        Raises:
            ValueError: If some of them are not there.
        """
        frames, damaged = np.empty((last - first, *self.frame), np.uint8), list[int]()
        at = first
        while at < last:
            file = at // self._per_file
            end = min(last, (file + 1) * self._per_file)
            start = at // WHOLE_EVERY * WHOLE_EVERY
            for number, (frame, sound) in enumerate(self._decoded(file, start, end), start):
                if number >= at:
                    frames[number - first] = frame
                    damaged += [] if sound else [number]
            at = end
        return frames, damaged

    def sync(self) -> None:
        """Fsync what was appended since the last time."""
        for path in self._unsynced:
            fsync(path)
        self._unsynced.clear()
        self._index.sync()

    def sync_all(self) -> None:
        """Fsync every file, whichever process has appended to it."""
        for path in (*self._files(), self.folder):
            fsync(path)
        self._index.sync_all()

    def cut(self, count: int) -> None:
        """Set the frames from ``count`` on aside in a tail file."""
        if count >= self.count:
            return
        self.sync()  # while all files are there
        first, at = divmod(count, self._per_file)
        start = int(self._index.read(count, count + 1)[0]["start"]) if at else 0
        numbers = {path: number_of(path) for path in self._files()}
        starts = {p: start if n == first else 0 for p, n in numbers.items() if n >= first}
        write_tail(self.folder, count, starts)
        self._index.cut(count)
        cut_files(self.folder, starts)
        self._last = None

    def forget(self, first: int) -> None:
        """Remove the files that lie wholly before frame ``first``."""
        self.sync()
        for path in self._files():
            if (number_of(path) + 1) * self._per_file <= first:
                path.unlink()
        self._index.forget(first // WHOLE_EVERY * WHOLE_EVERY)  # reading begins at a whole frame

    def close(self) -> None:
        """Close the file that grows."""
        self._index.close()

    def _read_about(self) -> None:
        path = self.folder / ABOUT
        try:
            about: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            version, self.key = about["version"], tuple(about["key"])
            self.image, self.frame = tuple(about["image"]), tuple(about["frame"])
            self._per_file = int(about["frames_per_file"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: expected a description of frames, got {error}") from error
        if version != VERSION:
            raise ValueError(f"{path}: expected version {VERSION}, got {version}")

    def _files(self) -> list[Path]:
        return sorted(self.folder.glob("frames_*.bin"))

    def _path(self, file: int) -> Path:
        return self.folder / f"frames_{file:06d}.bin"

    def _end(self) -> int:
        """Where the last frame's bytes end in its file."""
        last = self._index.read(self.count - 1, self.count)[0]
        return int(last["start"] + last["size"])

    def _last_frame(self) -> Frames | None:
        """The newest frame; None if there is none, or it is damaged and nothing can build on it."""
        if self._last is None and self.count:
            (last,), damaged = self.read(self.count - 1, self.count)
            self._last = None if damaged else last
        return self._last

    def _write(self, data: bytes, file: int, start: int) -> None:
        path = self._path(file)
        self._unsynced |= {path, self.folder}
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT, 0o666)
        try:
            os.ftruncate(descriptor, start)  # what a kill has left half written
            write_at(descriptor, data, start, path, f"{self.count} frames")
        finally:
            os.close(descriptor)

    def _decoded(self, file: int, first: int, last: int) -> Iterator[tuple[Frames, bool]]:
        """Yield frames from one that stands for itself on, and whether each is what was written."""
        path = self._path(file)
        if not path.is_file():
            raise ValueError(f"{path}: expected frames {first} to {last - 1}, got no file")
        data = path.read_bytes()
        index, damaged = self._index.read(first, last)
        frame, sound = np.zeros(self.frame, np.uint8), False
        columns = (index[name].tolist() for name in ("start", "size", "kind", "crc"))
        for number, (start, size, kind, crc) in enumerate(zip(*columns, strict=True), first):
            part = data[start : start + size] if number not in damaged else b""
            sound = zlib.crc32(part) == crc and len(part) > 0 and (kind == WHOLE or sound)
            if sound:
                pixels = np.frombuffer(zlib.decompress(part), np.uint8).reshape(self.frame)
                frame = pixels if kind == WHOLE else frame + pixels
            yield frame, sound


def _compress(frame: Frames, before: Frames | None) -> tuple[int, bytes]:
    """Return a frame's kind and bytes."""
    if before is None:
        return WHOLE, zlib.compress(frame.tobytes(), LEVEL)
    difference = zlib.compress((frame - before).tobytes(), LEVEL)
    if len(difference) * GOOD <= frame.size:
        return DIFFERENCE, difference
    whole = zlib.compress(frame.tobytes(), LEVEL)
    return (WHOLE, whole) if len(whole) < len(difference) else (DIFFERENCE, difference)
