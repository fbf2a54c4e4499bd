"""Frames are stored once, come back as they were, and what was damaged is known."""

import json
import multiprocessing
import os
import signal

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from rrl.trainers.storage import frame_log, transition_log
from rrl.trainers.storage.frame_log import FrameLog
from rrl.trainers.storage.replay_store import ReplayStore

SIDE = 8


def frames(number, seed=0, moving=True):
    """Noise of which a corner changes, or all."""
    draw = np.random.default_rng(seed)
    out = np.repeat(draw.integers(0, 256, (1, 3, SIDE, SIDE), np.uint8), number, 0)
    changing = out if moving else out[:, :, :2, :2]
    changing[:] = draw.integers(0, 256, changing.shape, np.uint8)
    return out


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr(frame_log, "FRAMES_PER_FILE", 64)


@pytest.fixture
def synced(monkeypatch):
    """What is synced from now on."""
    paths = []
    for module in (frame_log, transition_log):
        monkeypatch.setattr(module, "sync", paths.append)
    return paths


@pytest.fixture
def log(small, tmp_path):
    return FrameLog.create(tmp_path / "images_00", ["pixels"], [SIDE, SIDE, 3], [3, SIDE, SIDE])


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
    with pytest.raises(ValueError, match=r"image.json does not describe frames"):
        FrameLog(log.folder)


def test_opening_makes_nothing(tmp_path):
    with pytest.raises(ValueError, match=r"image.json does not describe frames: .*No such file"):
        FrameLog(tmp_path / "images_00")
    assert not list(tmp_path.iterdir())


def collected(shape, steps=12, envs=2, seed=0, stacked=1, start=None):
    """Random pictures as an environment shows them: an episode ends every five steps."""
    draw = torch.Generator().manual_seed(seed)

    def new():
        if stacked == 1:
            return torch.randint(0, 256, (envs, *shape), generator=draw, dtype=torch.uint8)
        one = torch.randint(0, 256, (envs, 3, *shape[1:]), generator=draw, dtype=torch.uint8)
        return one.repeat(1, stacked, 1, 1)

    now, then, done = [], [], []
    shown = new() if start is None else start
    for step in range(steps):
        now.append(shown)
        following = new()
        if stacked > 1:
            following = torch.cat([shown[:, 3:], following[:, :3]], 1)
        then.append(following)
        done.append(torch.full((envs, 1), step % 5 == 4))
        shown = new() if step % 5 == 4 else following
    over = torch.stack(done, 1)
    following = {"pixels": torch.stack(then, 1), "reward": over.float(), "done": over}
    data = {"pixels": torch.stack(now, 1), "action": torch.zeros(envs, steps, 2)}
    data["next"] = {**following, "terminated": over.clone()}
    return TensorDict(data, [envs, steps]), shown


SHAPES = {
    "last": ((8, 8, 3), 1),
    "first": ((3, 8, 8), 1),
    "stacked": ((9, 12, 12), 3),
    "gray": ((8, 8, 1), 1),
}


@pytest.mark.parametrize("kind", SHAPES)
def test_each_frame_is_stored_once_and_every_image_comes_back(tmp_path, kind):
    shape, stacked = SHAPES[kind]
    store = ReplayStore(tmp_path, 1000, 4)
    first, shown = collected(shape, stacked=stacked)
    second, _ = collected(shape, seed=1, stacked=stacked, start=shown)
    expected = []
    for data in (first, second):
        store.extend(data)
        expected.append(data.transpose(0, 1).reshape(-1))
    expected = torch.cat(expected)
    stored = store.newest()
    for key in ("pixels", ("next", "pixels")):
        assert torch.equal(stored[key], expected[key])
    # Of each environment: one frame a step, and one more for each of the five episodes.
    (log,) = (entry.log for entry in store.images._entries.values())
    assert log.count == 2 * (24 + 5)
    assert store.sample(3)["pixels"].shape == (3, 4, *shape)
    assert store.sample(3)["pixels"].dtype == torch.uint8


def test_an_oldest_frame_is_forgotten_with_its_transition(small, tmp_path, monkeypatch):
    monkeypatch.setattr("rrl.trainers.storage.frame_memory.BLOCK", 16)
    store = ReplayStore(tmp_path, 40, 4, n_step=2)
    shown = None
    for seed in range(10):
        data, shown = collected((8, 8, 3), seed=seed, start=shown)
        store.extend(data)
    (entry,) = store.images._entries.values()
    assert len(entry.memory._blocks) <= 5
    assert store.newest()["pixels"].shape == (40, 8, 8, 3)
    store.forget(200)
    assert len(list(entry.log.folder.glob("frames_*.bin"))) == 2
    again = ReplayStore(tmp_path, 40, 4, n_step=2)
    again.check(store.mark())


def test_a_store_filled_from_disk_is_the_one_that_was_left(tmp_path):
    left = ReplayStore(tmp_path / "run", 30, 4, n_step=3, gamma=0.9)
    shown = None
    for seed in range(3):
        data, shown = collected((8, 8, 3), seed=seed, start=shown)
        left.extend(data)
    state, mark = left.state_dict(), left.mark()
    after, shown = collected((8, 8, 3), seed=3, start=shown)
    left.extend(after)
    numbers = left.log.read(0, left.count)[0]
    left.close()
    again = ReplayStore(tmp_path / "run", 30, 4, n_step=3, gamma=0.9)
    again.check(mark)
    again.load_state_dict(state)
    assert again.pending == 24
    again.set_pending_aside()
    again.extend(after)
    assert (again.log.read(0, again.count)[0] == numbers).all()
    assert (again.newest() == left.newest()).all()


@pytest.mark.usefixtures("small")
def test_what_was_stored_after_a_checkpoint_is_recovered_with_its_frames(tmp_path, synced):
    left = ReplayStore(tmp_path / "run", 100, 4)
    data, shown = collected((8, 8, 3))
    left.extend(data)
    state = left.state_dict()
    for seed in (1, 2):
        data, shown = collected((8, 8, 3), seed=seed, start=shown)
        left.extend(data)
    left.close()
    synced.clear()
    again = ReplayStore(tmp_path / "run", 100, 4)
    again.load_state_dict(state)
    again.keep_whole_rounds(24)
    for _ in range(2):
        again.recover(24)
    again.mark()  # covers what nobody has synced
    assert set((tmp_path / "run").rglob("*.bin")) <= set(synced)
    assert (again.newest() == left.newest()).all()
    fresh, _ = collected((8, 8, 3), seed=9)  # a machine begins a new episode
    again.extend(fresh)
    assert torch.equal(again.newest()["pixels"][-24:], fresh.transpose(0, 1).reshape(-1)["pixels"])


def test_a_checkpoint_whose_frames_are_gone_is_refused(tmp_path):
    store = ReplayStore(tmp_path, 100, 4)
    store.extend(collected((8, 8, 3))[0])
    mark = store.mark()
    (entry,) = store.images._entries.values()
    entry.log.cut(3)
    with pytest.raises(ValueError, match=r"images_00: expected 30 frames, got 3"):
        store.check(mark)


def _killed_while_describing(run_dir, entry):
    write = frame_log.write_atomically

    def kill(path, text):
        if json.loads(text)["key"] == [entry]:
            os.kill(os.getpid(), signal.SIGKILL)
        write(path, text)

    frame_log.write_atomically = kill
    ReplayStore(run_dir, 100, 4).extend(two_cameras())


def two_cameras():
    data, _ = collected((8, 8, 3))
    for half in (data, data["next"]):
        half["wrist"] = half["pixels"] + 1
    return data


@pytest.mark.parametrize("entry", ["pixels", "wrist"])
def test_a_kill_before_the_first_frame_leaves_a_run_that_goes_on(tmp_path, entry):
    victim = multiprocessing.get_context("fork").Process(
        target=_killed_while_describing, args=(tmp_path, entry)
    )
    victim.start()
    victim.join()
    assert victim.exitcode == -signal.SIGKILL
    data = two_cameras()
    store = ReplayStore(tmp_path, 100, 4)
    assert store.count == store.pending == 0
    store.set_pending_aside()
    store.extend(data)
    again = ReplayStore(tmp_path, 100, 4)
    again.load_state_dict(store.state_dict())
    for one in (store, again):
        assert (one.newest() == data.transpose(0, 1).reshape(-1)).all()
    assert len(list(store.log.folder.glob("images_*"))) == 2


def test_only_the_images_that_are_wanted_are_given(tmp_path):
    store = ReplayStore(tmp_path, 100, 4)
    store.extend(two_cameras())
    every = store.newest()
    for wanted in ([], ["wrist"]):
        left_out = [key for key in ("pixels", "wrist") if key not in wanted]
        expected = every.exclude(*left_out, *(("next", key) for key in left_out))
        assert set(store.newest(wanted).keys(True, True)) == set(expected.keys(True, True))
        assert (store.newest(wanted) == expected).all()


def test_transitions_without_images_are_stored_as_ever(tmp_path):
    store = ReplayStore(tmp_path, 100, 4)
    data = collected((8, 8, 3))[0].exclude("pixels", ("next", "pixels"))
    store.extend(data)
    assert not list(store.log.folder.glob("images_*"))
    assert store.mark().keys() == {"count", "checksum"}
    assert store.portions(100) == [100]
    assert store.log.folder.joinpath("schema.json").is_file()
