"""A log of frames: they come back as they were, and what was damaged is known."""

import json
from functools import partial

import numpy as np
import pytest

from rrl.trainers.storage import frame_log
from rrl.trainers.storage.frame_log import FrameLog
from rrl.trainers.storage.transition_log import TransitionLog

SIDE = 8


def frames(number, seed=0, moving=True):
    """Noise of which a corner changes, or all."""
    draw = np.random.default_rng(seed)
    out = np.repeat(draw.integers(0, 256, (1, 3, SIDE, SIDE), np.uint8), number, 0)
    changing = out if moving else out[:, :, :2, :2]
    changing[:] = draw.integers(0, 256, changing.shape, np.uint8)
    return out


def create(folder):
    return FrameLog.create(folder / "images_00", ["pixels"], [SIDE, SIDE, 3], [3, SIDE, SIDE])


@pytest.fixture
def log(short_files, tmp_path):
    return create(tmp_path)


@pytest.mark.parametrize("moving", [False, True])
def test_frames_are_read_back_across_files_and_after_reopening(log, moving):
    wanted = frames(150, moving=moving)
    for part in np.split(wanted, [1, 30, 31, 100]):
        log.append(part)
    reopened = FrameLog(log.folder)
    assert (reopened.key, reopened.image, reopened.frame) == (("pixels",), (8, 8, 3), (3, 8, 8))
    for first, last in ((0, 150), (33, 34), (63, 65), (140, 150), (5, 5)):
        for one in (log, reopened):
            read, damaged = one.read(first, last)
            assert np.array_equal(read, wanted[first:last])
            assert not damaged
    more = frames(20, 1, moving)
    reopened.append(more)
    assert np.array_equal(FrameLog(log.folder).read(150, 170)[0], more)
    assert len(list(log.folder.glob("frames_*.bin"))) == 3


def test_what_hardly_changes_takes_hardly_any_room(log):
    log.append(frames(64, moving=False))
    whole = log.folder / "frames_000000.bin"
    assert whole.stat().st_size < 64 * 3 * SIDE * SIDE / 3


def flip_a_bit(log, number):
    entry = log._index.read(number, number + 1)[0]
    path = log.folder / "frames_000000.bin"
    content = bytearray(path.read_bytes())
    content[int(entry["start"]) + 3] ^= 4
    path.write_bytes(content)


def test_what_is_written_after_a_damaged_frame_does_not_build_on_it(log):
    wanted = frames(60, moving=False)
    log.append(wanted[:40])
    flip_a_bit(log, 39)
    reopened = FrameLog(log.folder)
    reopened.append(wanted[40:])
    read, damaged = reopened.read(0, 60)
    assert damaged == [39]
    assert np.array_equal(read[40:], wanted[40:])


@pytest.mark.parametrize("number", [0, 40, 63])
def test_a_flipped_bit_is_found_and_the_frame_before_stands_for_the_damaged(log, number):
    wanted = frames(64)
    log.append(wanted)
    flip_a_bit(log, number)
    read, damaged = log.read(0, 64)
    assert damaged[0] == number
    sound = [i for i in range(64) if i not in damaged]
    assert np.array_equal(read[sound], wanted[sound])
    assert all(n // 32 == number // 32 for n in damaged)
    if number:
        assert np.array_equal(read[number], wanted[number - 1])


@pytest.mark.parametrize("count", [0, 1, 40, 64, 100, 129])
def test_cutting_keeps_the_tail(log, count):
    wanted = frames(130)
    log.append(wanted)
    before = log.checksum(count)
    log.cut(count)
    assert log.count == FrameLog(log.folder).count == count
    assert log.checksum(count) == before
    assert len(list(log.folder.glob("tail_*.bin"))) == 1
    log.append(wanted[count:])
    assert np.array_equal(FrameLog(log.folder).read(0, 130)[0], wanted)


def test_a_torn_frame_is_written_over(log):
    wanted = frames(40)
    log.append(wanted)
    with (log.folder / "frames_000000.bin").open("ab") as file:
        file.write(b"half a frame, longer than what comes" * 100)
    log = FrameLog(log.folder)
    log.append(wanted[:3])
    assert np.array_equal(FrameLog(log.folder).read(40, 43)[0], wanted[:3])


def test_an_unreadable_description_is_named(log):
    (log.folder / "image.json").write_text(json.dumps({"version": 1}))
    with pytest.raises(ValueError, match=r"image.json: expected a description of frames"):
        FrameLog(log.folder)


def test_opening_makes_nothing(tmp_path):
    with pytest.raises(
        ValueError, match=r"image.json: expected a description of frames, got .*No such file"
    ):
        FrameLog(tmp_path / "images_00")
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("short_files")
@pytest.mark.parametrize("first", range(60, 72))
def test_what_is_not_forgotten_can_be_read(monkeypatch, tmp_path, first):
    """Files of the index end in the middle of frames that build on one another."""
    monkeypatch.setattr(frame_log, "TransitionLog", partial(TransitionLog, segment_bytes=1000))
    log, wanted = create(tmp_path), frames(150, moving=False)
    log.append(wanted)
    log.forget(first)
    assert np.array_equal(log.read(first, 150)[0], wanted[first:])
