"""Writing that a crash cannot tear, and checksums that tell when something else did."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rrl.sealed import fingerprint, sealed, unsealed

SEAL = "seal.json"
LOCK = ".lock"
SCHEMA_VERSION = 2


def write_atomically(path: Path, text: str) -> None:
    """Replace ``path`` by ``text``; a reader finds all of the old or all of the new.

    Paths in ``text`` whose bytes Python could not decode are written as these bytes.
    """
    partial = path.with_name(f".{path.name}.partial")
    with partial.open("w", encoding="utf-8", errors="surrogateescape") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
    fsync(path.parent)


def number_of(path: Path) -> int:
    """Return the number at the end of a numbered file's name."""
    return int(path.stem.rpartition("_")[2])


def write_tail(folder: Path, count: int, starts: Mapping[Path, int]) -> Path | None:
    """Write what a log holds from number ``count`` on, at these bytes of its files, beside it.

    Returns:
        Where; None if there is nothing.

    Raises:
        OSError: If it cannot be written; the log is then as it was.
    """
    data = b"".join(path.read_bytes()[start:] for path, start in starts.items())
    if not data:
        return None
    taken = len(list(folder.glob(f"tail_{count:012d}_*.bin")))
    out = folder / f"tail_{count:012d}_{taken:03d}.bin"
    partial = out.with_suffix(".partial")
    partial.write_bytes(data)
    fsync(partial)
    partial.replace(out)
    fsync(folder)
    return out


def cut_files(folder: Path, starts: dict[Path, int]) -> None:
    """Cut a log's files at these bytes; one that would be empty is removed."""
    for path, start in reversed(starts.items()):  # from the end: never a hole
        if start:
            os.truncate(path, start)
        else:
            path.unlink()
    fsync(folder)


def fsync(path: Path) -> None:
    """Flush a file's content, or a directory's list of names, to the disk.

    Some file systems (network shares, FUSE) have no such operation for a directory and say EINVAL;
    there it is theirs to keep the names.

    Raises:
        OSError: With the path, if that fails.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL or not path.is_dir():
            raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        os.close(descriptor)


def write_at(descriptor: int, data: Any, start: int, path: Path, whole: str) -> None:
    """Write all of ``data`` at byte ``start`` of an open file, or nothing of it.

    Args:
        descriptor: Of the file.
        data: Bytes.
        start: Where they go.
        path: Of the file, for the message.
        whole: What lies before them and is whole, for the message.

    Raises:
        OSError: If they cannot be written, as where the disk is full; the file is cut at ``start``.
    """
    try:
        written = 0
        while written < len(data):
            written += os.pwrite(descriptor, data[written:], start + written)
    except OSError as error:
        os.ftruncate(descriptor, start)
        text = f"{error.strerror}; {whole} before it are whole"
        raise OSError(error.errno, text, str(path)) from error


def lock(folder: Path) -> int:
    """Claim a directory until the returned descriptor is closed, or the process dies.

    NFS locks only what is open for writing, which a directory cannot be, and says EBADF; there the
    file ``.lock`` in it stands for it.

    Raises:
        BlockingIOError: If another process has claimed it.
        OSError: If the file system cannot lock.
    """
    try:
        try:
            return _locked(folder, os.O_RDONLY)
        except OSError as error:
            if error.errno != errno.EBADF:
                raise
        return _locked(folder / LOCK, os.O_RDWR | os.O_CREAT)
    except BlockingIOError:
        raise BlockingIOError(
            f"{folder}: expected a directory that is free, but another process is training in it"
        ) from None


def require_unclaimed(folder: Path) -> None:
    """Raise if another process has claimed a directory; one that is not there yet is free.

    Raises:
        BlockingIOError: If another process has.
        OSError: If the file system cannot lock.
    """
    if folder.is_dir():
        os.close(lock(folder))


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Claim a directory, which is made if need be, while the body runs; see :func:`lock`."""
    folder.mkdir(parents=True, exist_ok=True)
    held = lock(folder)
    try:
        yield
    finally:
        os.close(held)


def _locked(path: Path, flags: int) -> int:
    descriptor = os.open(path, flags, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def seal(folder: Path, note: Mapping[str, Any]) -> None:
    """Write ``seal.json`` with size and SHA-256 of every file below ``folder``; fsync all.

    Its content is ``{"version": 2, "files": {name: {"bytes": n, "sha256": "..."}}, "note": {}}``.
    """
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    inventory = {str(path.relative_to(folder)): fingerprint(path) for path in files}
    for path in files:
        fsync(path)
    content = {"version": SCHEMA_VERSION, "files": inventory, "note": dict(note)}
    write_atomically(folder / SEAL, sealed(content))
    for directory in (*(p for p in folder.rglob("*") if p.is_dir()), folder):
        fsync(directory)


def check_seal(folder: Path) -> dict[str, Any]:
    """Compare every file below ``folder`` with its checksum.

    Returns:
        The note that was sealed with the files.

    Raises:
        ValueError: Whatever is missing, truncated, changed or of another schema version, by name.
    """
    content = _read_content(folder / SEAL)
    for name, expected in content["files"].items():
        path = folder / name
        if not path.is_file():
            raise ValueError(f"{name}: expected a file, got none")
        found = fingerprint(path)
        if found["bytes"] != expected["bytes"]:
            raise ValueError(f"{name}: expected {expected['bytes']} bytes, got {found['bytes']}")
        if found != expected:
            raise ValueError(f"{name}: expected what was written, got another SHA-256")
    return dict(content["note"])


def read_note(folder: Path) -> dict[str, Any]:
    """The note that was sealed with the files below ``folder``, without looking at the files.

    Raises:
        ValueError: If ``seal.json`` is missing, changed or of another schema version.
    """
    return dict(_read_content(folder / SEAL)["note"])


def _read_content(path: Path) -> dict[str, Any]:
    try:
        content = unsealed(path.read_bytes())
    except FileNotFoundError:
        raise ValueError(f"{path.name}: expected a file, got none") from None
    except ValueError as error:
        raise ValueError(f"{path.name} is {error}") from error
    if content["version"] != SCHEMA_VERSION:
        raise ValueError(
            f"{path.name}: expected schema version {SCHEMA_VERSION}, got {content['version']}"
        )
    return content
