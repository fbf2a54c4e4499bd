"""Runs that were stopped, short files of frames, and a disk of its own."""

import subprocess
from functools import partial

import pytest

from rrl.trainers.storage import frame_log


@pytest.fixture
def make(make_trainer, simulated):
    return partial(make_trainer, environment=simulated)


@pytest.fixture
def stopped(make, tmp_path):
    """A run of 200 steps with checkpoints at 100 and 200, and its directory."""
    trainer = make()
    trainer.run()
    trainer.close()
    return tmp_path / "run"


@pytest.fixture
def short_files(monkeypatch):
    """A file of a log of frames ends after 64 of them."""
    monkeypatch.setattr(frame_log, "FRAMES_PER_FILE", 64)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 4 MB of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", folder], check=True)
    yield folder
    subprocess.run(["umount", "--lazy", folder], check=True)
