"""Four calls over a socket: messages as msgpack, arrays as their bytes."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np

from rrl.robot import Description, EntrySpec

ADDRESS = "ipc:///tmp/rrl-plant"
"""Where a plant listens if nothing else is said; tcp://HOST:PORT reaches other machines."""

_ARRAY = "__array__"


def pack(message: dict[str, Any]) -> bytes:
    """Return a message as bytes; NumPy arrays may be in it."""
    packed: bytes = msgpack.packb(message, default=_encode)
    return packed


def unpack(data: bytes) -> dict[str, Any]:
    """Undo :func:`pack`."""
    message: dict[str, Any] = msgpack.unpackb(data, object_hook=_decode, use_list=False)
    return message


def to_description(message: dict[str, Any]) -> Description:
    """Return the description whose fields were sent."""
    entries = {name: EntrySpec(*entry) for name, entry in message["entries"].items()}
    return Description(**{**message, "entries": entries})


def _encode(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.ascontiguousarray(value)
        return {_ARRAY: array.dtype.str, "shape": list(np.shape(value)), "bytes": array.tobytes()}
    raise TypeError(f"message: expected numbers, text and arrays, got a {type(value).__name__}")


def _decode(value: dict[str, Any]) -> Any:
    if _ARRAY in value:
        return np.frombuffer(value["bytes"], np.dtype(value[_ARRAY])).reshape(value["shape"])
    return value
