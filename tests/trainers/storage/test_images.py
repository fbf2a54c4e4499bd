"""Images in a replay store: each frame is stored once, and every image comes back."""

import json
import multiprocessing
import os
import signal

import pytest
import torch
from tensordict import TensorDict

from rrl.trainers.storage import frame_log, transition_log
from rrl.trainers.storage.replay_store import ReplayStore


@pytest.fixture
def synced(monkeypatch):
    """What is synced from now on."""
    paths = []
    for module in (frame_log, transition_log):
        monkeypatch.setattr(module, "fsync", paths.append)
    return paths


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


def test_an_oldest_frame_is_forgotten_with_its_transition(short_files, tmp_path, monkeypatch):
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


@pytest.mark.usefixtures("short_files")
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
