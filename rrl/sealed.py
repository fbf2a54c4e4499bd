"""JSON with its own checksum, so that a reader notices what is torn or was changed.

Layout::

    {"sha256": of the canonical JSON of "content", "content": {...}}
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def sealed(content: Mapping[str, Any]) -> str:
    """Return the text of a file that holds ``content``."""
    return json.dumps({"sha256": _digest(content), "content": content}, indent=1) + "\n"


def unsealed(text: bytes) -> dict[str, Any]:
    """Return the content of what :func:`sealed` gave.

    Raises:
        ValueError: If it is torn or was changed; the message goes on after "the file is".
    """
    try:
        node = json.loads(text)
        content, intact = dict(node["content"]), node["sha256"] == _digest(node["content"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"torn: {error}") from error
    if not intact:
        raise ValueError("not what was written (SHA-256 differs)")
    return content


def fingerprint(path: Path) -> dict[str, Any]:
    """Return a file's size, ``bytes``, and its ``sha256``."""
    checksum = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            checksum.update(block)
    return {"bytes": path.stat().st_size, "sha256": checksum.hexdigest()}


def _digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of ``content``, however it is laid out in the file."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
