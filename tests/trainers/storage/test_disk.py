"""Disks that are full, too small, read-only, or of another kind."""

import errno
import fcntl
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from rrl.trainers.settings import CheckpointSettings
from rrl.trainers.storage.files import fsync, lock
from rrl.trainers.storage.space_needed import memory_bytes, require_room
from rrl.trainers.training.realtime.hand_over import HandOver
from situation_commands import start

THOUSAND = {"total_steps": 1000}

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small file system needs root")


@needs_root
def test_a_disk_that_fills_up_within_a_checkpoint_keeps_the_one_before(make_trainer, small_disk):
    trainer = make_trainer(small_disk / "run", total_steps=100, warmup_steps=40)
    trainer.run()
    free = os.statvfs(small_disk)
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(free.f_bavail * free.f_frsize - 40_000))
    trainer.counters["env_steps"] = 120
    with pytest.raises(OSError, match=r"cannot write checkpoint .* No space left on device"):
        trainer._save()
    trainer.close()
    resumed = make_trainer(small_disk / "run", total_steps=100, warmup_steps=40)
    assert resumed.resume().name == "checkpoint-000000000100"
    resumed.close()


@needs_root
def test_a_read_only_folder_is_named(small_disk):
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    with start("train", f"hydra.run.dir={small_disk}/run", cwd=small_disk.parent) as process:
        _, errors = process.communicate(timeout=250)
    assert process.returncode == 2
    assert f"{small_disk}/run: Read-only file system" in errors.decode()


@needs_root
def test_transitions_that_the_disk_cannot_take_are_refused_at_once(make_trainer, small_disk):
    with pytest.raises(
        ValueError,
        match=r"the disk of .*/run, \d\.\d MB, got 1000000 of 46 bytes each, 46\.0 MB;",
    ):
        make_trainer(small_disk / "run", total_steps=1_000_000)
    make_trainer(small_disk / "run", total_steps=1_000_000, buffer_capacity=10_000).close()


def test_what_is_written_beside_them_counts_on_the_disk_alone(settings, tmp_path):
    free, memory, run = shutil.disk_usage(tmp_path).free, memory_bytes("cpu"), settings(**THOUSAND)
    require_room(tmp_path, run, 1, free // 2000)
    with pytest.raises(ValueError, match=r"what is free on the disk .*, got 1000 of "):
        require_room(tmp_path, run, 1, free // 500)
    require_room(tmp_path, run, 1, free // 500, written=800)
    with pytest.raises(ValueError, match="the memory of cpu"):
        require_room(tmp_path, run, memory, 1)


@pytest.mark.parametrize(("every", "keep", "stay"), [(100, 2, 300), (0, 2, 1000), (400, 3, 1000)])
def test_what_a_checkpoint_needs_stays_on_the_disk(settings, tmp_path, every, keep, stay):
    free = shutil.disk_usage(tmp_path).free
    saved = CheckpointSettings(every=every, keep=keep)
    run = settings(**THOUSAND, buffer_capacity=100, checkpoint=saved)
    require_room(tmp_path, run, 1, free // (2 * stay))
    with pytest.raises(ValueError, match=rf"got {stay} of .* save more often"):
        require_room(tmp_path, run, 1, 2 * free // stay)


def test_a_file_system_that_cannot_sync_a_folder_is_no_hindrance():
    """Such as /proc; of a file, which would be lost, it is named."""
    folder = Path("/proc/self")
    with pytest.raises(OSError, match="Invalid argument"):
        os.fsync(os.open(folder, os.O_RDONLY))
    fsync(folder)
    with pytest.raises(OSError, match="Invalid argument: '/proc/self/status'"):
        fsync(folder / "status")


@pytest.fixture
def _on_nfs(monkeypatch):
    """Linux's NFS client: an exclusive lock needs a file open for writing, a shared for reading."""
    flock = fcntl.flock

    def as_ranges(file, operation):
        mode = fcntl.fcntl(file, fcntl.F_GETFL) & os.O_ACCMODE
        if operation & fcntl.LOCK_EX and mode == os.O_RDONLY:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        if operation & fcntl.LOCK_SH and mode == os.O_WRONLY:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        flock(file, operation)

    monkeypatch.setattr(fcntl, "flock", as_ranges)


@pytest.mark.usefixtures("_on_nfs")
def test_a_folder_on_nfs_is_claimed_once(tmp_path):
    claimed = lock(tmp_path)
    with pytest.raises(BlockingIOError, match="another process is training in it"):
        lock(tmp_path)
    os.close(claimed)
    os.close(lock(tmp_path))


@pytest.mark.usefixtures("_on_nfs")
def test_a_robot_is_wanted_and_given_on_nfs(tmp_path):
    learner, acting = HandOver(tmp_path), HandOver(tmp_path)
    assert not acting.is_wanted()
    with learner.having_robot():
        assert acting.is_wanted()
    assert not acting.is_wanted()
