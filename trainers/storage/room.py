"""Whether the transitions of a run fit into memory and onto the disk, asked before it starts."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import torch
from rich.filesize import decimal

CGROUP = Path("/sys/fs/cgroup/memory.max")
"""Where a container's own limit stands."""


def require_room(
    run_dir: Path, transitions: int, in_memory: int, on_disk: int, device: str, written: int = 0
) -> None:
    """Refuse a run whose transitions do not fit.

    Args:
        run_dir: Where they are written; the folder exists.
        transitions: How many are kept.
        in_memory: Bytes of one there.
        on_disk: Bytes of one there, with what else is written of it.
        device: Where the replay buffer lies.
        written: How many of them are on the disk already.

    Raises:
        ValueError: If they need more than the device's memory, or than what is free on the disk.
    """
    free = shutil.disk_usage(run_dir).free
    places = (
        (transitions, in_memory, memory_bytes(device), f"the memory of {device}"),
        (max(0, transitions - written), on_disk, free, f"what is free on the disk of {run_dir}"),
    )
    for count, size, room, place in places:
        if count * size > room:
            raise ValueError(
                f"trainer.buffer_capacity: expected transitions that fit into {place}, "
                f"{decimal(room)}, got {transitions} of {decimal(size)} each, "
                f"{decimal(count * size)}; keep fewer, or let the policy read less"
            )


def memory_bytes(device: str) -> int:
    """Return how much memory a device has; of a container, how much it may use."""
    if torch.device(device).type == "cuda":
        return int(torch.cuda.mem_get_info(device)[1])
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    if CGROUP.is_file() and (text := CGROUP.read_text(encoding="utf-8").strip()).isdigit():
        limits.append(int(text))
    return min(limits)
