"""Every transition on disk the moment it is stored, in files that only grow.

Layout, below the run's directory::

    transitions/
        schema.json                  {"version", "records_per_segment", "fields"}; a field is
                                     [key, dtype, shape], its key a list of names
        segment_000000.bin           records 0 .. R - 1
        segment_000001.bin           records R .. 2R - 1; the last segment is the one that grows
        tail_000000005000_000.bin    records from 5000 on that a resumed run made anew

    one record:  field | field | ... | crc32

A record is one transition: its fields one after the other without gaps, little endian, then the
CRC-32 of these bytes continued from the record before it (the first of a segment from the segment's
number). So every record is checked by itself and for its place, and a checksum stands for all
before it. Nothing is pickled; ``numpy.fromfile`` reads it.

A record that was handed to the operating system survives the death of the process. With every
checkpoint :meth:`TransitionLog.sync` calls fsync, which is what a loss of power goes back to.
"""

from __future__ import annotations

import json
import os
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase

from .files import cut_files, fsync, number_of, write_at, write_atomically, write_tail
from .records import CHECKSUM, Records, columns, pack, raw, record_dtype

FOLDER = "transitions"
SCHEMA = "schema.json"
VERSION = 2
SEGMENT_BYTES = 16 * 2**20


class TransitionLog:
    """The transitions of one run, numbered from 0 in the order in which they were stored.

    Args:
        folder: Where the files lie; opened if it has any, made with the first transition if not.
        segment_bytes: Size at which a new segment starts.

    Attributes:
        count: Number of whole records.

    Raises:
        ValueError: If ``schema.json`` is of another version or unreadable.
    """

    def __init__(self, folder: Path, segment_bytes: int = SEGMENT_BYTES) -> None:
        self.folder, self._segment_bytes = folder, segment_bytes
        self.count = 0
        self._dtype: np.dtype[np.void] | None = None
        self._descriptor: int | None = None
        self._unsynced: set[Path] = set()
        if (folder / SCHEMA).is_file():
            self._open()

    def append(self, transitions: TensorDictBase) -> None:
        """Write transitions ``[n]`` behind the last one.

        Raises:
            ValueError: If they have other entries than the ones before.
            OSError: If they cannot be written; what was there before stays whole.
        """
        if self._dtype is None:
            self._create(transitions)
        records = pack(transitions, self._record)
        while len(records):
            segment, at = divmod(self.count, self._per_segment)
            part, records = np.split(records, [self._per_segment - at])
            self._seal(part, segment, at)
            self._write(part, segment, at)
            self.count += len(part)

    def checksum(self, count: int) -> int:
        """The checksum of record ``count - 1``, which stands for all before it; 0 for none."""
        return int(self._records(count - 1, count)[CHECKSUM][0]) if count else 0

    def read(self, first: int, last: int) -> tuple[TensorDict, list[int]]:
        """Records ``first .. last - 1``, and which of them fail their checksum."""
        records = self._records(first, last)
        damaged = self._damaged(records, first)
        fields = {
            tuple(json.loads(name)): torch.from_numpy(records[name].copy())
            for name in self._record.names or ()
            if name != CHECKSUM
        }
        return TensorDict(fields, [len(records)]), damaged

    def refresh(self) -> int:
        """Look how many records another process has appended by now; return :attr:`count`."""
        if self._dtype is not None or (self.folder / SCHEMA).is_file():
            self._open()
        return self.count

    def sync(self) -> None:
        """Fsync what was appended since the last time."""
        for path in self._unsynced:
            fsync(path)
        if self._unsynced:
            fsync(self.folder)
        self._unsynced.clear()

    def sync_all(self) -> None:
        """Fsync every segment, whichever process has appended to it."""
        for path in self._segments():
            fsync(path)
        if self.folder.is_dir():
            fsync(self.folder)

    def cut(self, count: int) -> Path | None:
        """Set the records from ``count`` on aside in a tail file of the same format.

        Returns:
            The tail file; None if there was nothing to set aside.
        """
        self.close()
        self.sync()  # while all of them are there
        starts = {}
        for path in self._segments():
            kept = count - number_of(path) * self._per_segment
            if kept < self._per_segment:
                starts[path] = max(0, kept) * self._record.itemsize
        tail = write_tail(self.folder, count, starts)
        if tail is not None:
            cut_files(self.folder, starts)
            self.count = count
        return tail

    def forget(self, first: int) -> None:
        """Remove the segments that lie wholly before record ``first``."""
        self.sync()
        for path in self._segments() if first > 0 else ():
            if (number_of(path) + 1) * self._per_segment <= first:
                path.unlink()

    def close(self) -> None:
        """Close the file that grows."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    @property
    def _record(self) -> np.dtype[np.void]:
        assert self._dtype is not None
        return self._dtype

    def _create(self, transitions: TensorDictBase) -> None:
        fields = [
            [json.loads(name), str(array.dtype), list(array.shape[1:])]
            for name, array in sorted(columns(transitions).items())
        ]
        size = record_dtype(fields).itemsize
        schema = {
            "version": VERSION,
            "records_per_segment": max(1, self._segment_bytes // size),
            "fields": fields,
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        write_atomically(self.folder / SCHEMA, json.dumps(schema, indent=1) + "\n")
        self._open()

    def _open(self) -> None:
        path = self.folder / SCHEMA
        try:
            schema: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            version = schema["version"]
            self._per_segment = int(schema["records_per_segment"])
            self._dtype = record_dtype(schema["fields"])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{path}: expected a description of records, got {error}") from error
        if version != VERSION:
            raise ValueError(f"{path}: expected version {VERSION}, got {version}")
        segments = self._segments()
        if segments:
            whole = segments[-1].stat().st_size // self._record.itemsize
            self.count = number_of(segments[-1]) * self._per_segment + whole

    def _segments(self) -> list[Path]:
        return sorted(self.folder.glob("segment_*.bin"))

    def _path(self, segment: int) -> Path:
        return self.folder / f"segment_{segment:06d}.bin"

    def _seal(self, records: Records, segment: int, at: int) -> None:
        """Fill in the checksums of records that go to place ``at`` of ``segment``."""
        checksum = self.checksum(self.count) if at else segment
        size = self._record.itemsize
        data = raw(records)
        for i in range(len(records)):
            checksum = zlib.crc32(data[i * size : (i + 1) * size - 4], checksum)
            records[CHECKSUM][i] = checksum

    def _write(self, records: Records, segment: int, at: int) -> None:
        path, start = self._path(segment), at * self._record.itemsize
        if at == 0 or self._descriptor is None:
            self.close()
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT, 0o666)
        self._unsynced.add(path)
        write_at(self._descriptor, raw(records), start, path, f"{self.count} transitions")

    def _records(self, first: int, last: int) -> Records:
        """Raw records, from as many segments as it takes.

        Raises:
            ValueError: If some of them are not there.
        """
        parts, at = [], first
        while at < last:
            segment, offset = divmod(at, self._per_segment)
            number = min(last - at, self._per_segment - offset)
            path = self._path(segment)
            part = np.empty(0, self._record)
            if path.is_file():
                part = np.fromfile(
                    path, self._record, number, offset=offset * self._record.itemsize
                )
            if len(part) < number:
                raise ValueError(f"{path}: expected record {at + number}, got the end of the file")
            parts.append(part)
            at += number
        return np.concatenate(parts) if parts else np.empty(0, self._record)

    def _damaged(self, records: Records, first: int) -> list[int]:
        size = self._record.itemsize
        data = raw(records)
        stored: list[int] = records[CHECKSUM].tolist()
        in_segment = first % self._per_segment
        before = self.checksum(first) if in_segment and len(records) else 0
        damaged = []
        for i, checksum in enumerate(stored):
            segment, at = divmod(first + i, self._per_segment)
            found = zlib.crc32(data[i * size : (i + 1) * size - 4], before if at else segment)
            if found != checksum:
                damaged.append(first + i)
            before = checksum
        return damaged
