"""What is not forgotten of a log of frames can be read."""

from functools import partial

import numpy as np
import pytest

from rrl.trainers.storage import frame_log
from rrl.trainers.storage.frame_log import FrameLog
from rrl.trainers.storage.transition_log import TransitionLog

SIDE = 8


@pytest.mark.parametrize("first", range(60, 72))
def test_what_is_not_forgotten_can_be_read(monkeypatch, tmp_path, first):
    """Files of the index end in the middle of frames that build on one another."""
    monkeypatch.setattr(frame_log, "FRAMES_PER_FILE", 64)
    monkeypatch.setattr(frame_log, "TransitionLog", partial(TransitionLog, segment_bytes=1000))
    log = FrameLog.create(tmp_path / "images", ["pixels"], [SIDE, SIDE, 3], [3, SIDE, SIDE])
    draw = np.random.default_rng(0)
    wanted = np.repeat(draw.integers(0, 256, (1, 3, SIDE, SIDE), np.uint8), 150, 0)
    wanted[:, :, :2, :2] = draw.integers(0, 256, (150, 3, 2, 2), np.uint8)  # only a corner moves
    log.append(wanted)
    log.forget(first)
    assert np.array_equal(log.read(first, 150)[0], wanted[first:])
