"""Whether the transitions of a run fit into memory and onto the disk, asked before it starts."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import torch
from rich.filesize import decimal

from ..settings import TrainerSettings

CGROUP = Path("/sys/fs/cgroup/memory.max")
"""Where a container's own limit stands."""


def require_room(
    run_dir: Path, settings: TrainerSettings, in_memory: int, on_disk: int, written: int = 0
) -> None:
    """Refuse a run whose transitions do not fit.

    Args:
        run_dir: Where they are written; the folder exists.
        settings: Of the run: how many are kept, and where the replay buffer lies.
        in_memory: Bytes of one there.
        on_disk: Bytes of one there, with what else is written of it.
        written: How many of them are on the disk already.

    Raises:
        ValueError: If they need more than the device's memory, or than what is free on the disk.
    """
    free, device = shutil.disk_usage(run_dir).free, settings.device
    kept, stay = settings.kept_transitions, kept_on_disk(settings)
    often = "save more often (trainer.checkpoint.every), "
    places = (
        (kept, 0, in_memory, memory_bytes(device), f"the memory of {device}", ""),
        (stay, written, on_disk, free, f"what is free on the disk of {run_dir}", often),
    )
    for count, there, size, room, place, remedy in places:
        if (count - there) * size > room:
            raise ValueError(
                f"trainer.buffer_capacity: expected transitions that fit into {place}, "
                f"{decimal(room)}, got {count} of {decimal(size)} each, "
                f"{decimal(count * size)}; keep fewer, {remedy}or let the policy read less"
            )


def kept_on_disk(settings: TrainerSettings) -> int:
    """Return how many transitions are on the disk at most.

    A checkpoint needs those of the buffer as it was; what none needs is removed with the next one.
    """
    every, keep = settings.checkpoint.every, settings.checkpoint.keep
    stay = settings.kept_transitions + keep * every if every else settings.total_steps
    return max(1, min(stay, settings.total_steps))


def memory_bytes(device: str) -> int:
    """Return how much memory a device has; of a container, how much it may use."""
    if torch.device(device).type == "cuda":
        return int(torch.cuda.mem_get_info(device)[1])
    limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    if CGROUP.is_file() and (text := CGROUP.read_text(encoding="utf-8").strip()).isdigit():
        limits.append(int(text))
    return min(limits)
