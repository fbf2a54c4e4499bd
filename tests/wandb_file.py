"""Reads what an offline Weights & Biases run wrote: protocol buffers in LevelDB's log format."""

import json
from dataclasses import dataclass, field
from pathlib import Path

from wandb.proto import wandb_internal_pb2

FILE_HEADER, BLOCK, RECORD_HEADER = 7, 32768, 7
FULL, FIRST, MIDDLE, LAST = 1, 2, 3, 4


@dataclass
class OfflineRun:
    """What the server would show; ``history`` and ``config`` with their values decoded from JSON."""

    folder: Path
    run: wandb_internal_pb2.RunRecord | None = None
    config: dict = field(default_factory=dict)
    history: list[dict] = field(default_factory=list)
    metrics: list[wandb_internal_pb2.MetricRecord] = field(default_factory=list)

    def rows(self, key):
        """History rows that have ``key``."""
        return [row for row in self.history if key in row]


def read(folder: Path) -> OfflineRun:
    """Read the one ``.wandb`` file of an ``offline-run-*`` folder."""
    (path,) = folder.glob("*.wandb")
    out = OfflineRun(folder)
    for data in _records(path.read_bytes()):
        record = wandb_internal_pb2.Record.FromString(data)
        kind = record.WhichOneof("record_type")
        if kind == "run":
            out.run = record.run
            out.config |= {
                item.key: json.loads(item.value_json) for item in record.run.config.update
            }
        elif kind == "metric":
            out.metrics.append(record.metric)
        elif kind == "history":
            items = record.history.item
            out.history.append(
                {i.key or "/".join(i.nested_key): json.loads(i.value_json) for i in items}
            )
    return out


def _records(content: bytes):
    """LevelDB's log: blocks of 32 KiB, each piece with checksum (4), length (2) and type (1) before it."""
    position, pieces = FILE_HEADER, b""
    while position + RECORD_HEADER <= len(content):
        if BLOCK - position % BLOCK < RECORD_HEADER:
            position += BLOCK - position % BLOCK
            continue
        length = int.from_bytes(content[position + 4 : position + 6], "little")
        kind = content[position + 6]
        position += RECORD_HEADER
        piece = content[position : position + length]
        position += length
        pieces = piece if kind in (FULL, FIRST) else pieces + piece
        if kind in (FULL, LAST) and pieces:
            yield pieces
