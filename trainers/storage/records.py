"""Transitions as records: their fields one after the other, and a checksum."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase

CHECKSUM = "crc32"

Records = NDArray[np.void]


def raw(records: Records) -> memoryview:
    """Return the bytes of records."""
    return records.view(np.uint8).reshape(-1).data


def _name(key: NestedKey) -> str:
    """Return a field's name: the key as JSON, whatever characters it has."""
    return json.dumps([key] if isinstance(key, str) else list(key))


def record_dtype(fields: list[Any]) -> np.dtype[np.void]:
    """Return the type of a record of ``fields``, each ``[key, dtype, shape]``, and its checksum."""
    entries = [
        (_name(tuple(key)), np.dtype(dtype).newbyteorder("<"), tuple(shape))
        for key, dtype, shape in fields
    ]
    return np.dtype([*entries, (CHECKSUM, "<u4")])


def columns(transitions: TensorDictBase) -> dict[str, NDArray[Any]]:
    """Return the entries of transitions ``[n]`` by the names of their fields."""
    return {_name(k): v.cpu().numpy() for k, v in transitions.items(True, True)}


def pack(transitions: TensorDictBase, record: np.dtype[np.void]) -> Records:
    """Return transitions ``[n]`` as records without their checksums.

    Raises:
        ValueError: If they have other entries, shapes or types than a record.
    """
    arrays = columns(transitions)
    expected = set(record.names or ()) - {CHECKSUM}
    if arrays.keys() != expected:
        raise ValueError(f"transitions: expected {sorted(expected)}, got {sorted(arrays)}")
    records = np.zeros(len(transitions), record)
    for name, array in arrays.items():
        wanted = record[name]
        if array.shape[1:] != wanted.shape or array.dtype != wanted.base:
            raise ValueError(
                f"transition entry {name}: expected {wanted.shape} of {wanted.base}, "
                f"got {array.shape[1:]} of {array.dtype}"
            )
        records[name] = array
    return records
