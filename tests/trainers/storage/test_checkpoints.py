"""Checkpoints: whole or known not to be, small, free of code, and only of the same run."""

import logging
import os
import pickle

import pytest
import torch

from rrl.trainers.settings import CheckpointSettings
from rrl.trainers.storage import files
from rrl.trainers.storage.checkpoints import load_components
from rrl.trainers.storage.space_needed import kept_on_disk
from toy_envs import EPISODE_STEPS


def newest(run_dir):
    return sorted((run_dir / "checkpoints").glob("checkpoint-*"))[-1]


def same_state(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same_state(one[k], other[k]) for k in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same_state, one, other))
    if isinstance(one, torch.Tensor):
        return torch.equal(one, other)
    return one == other


def truncate(path):
    os.truncate(path, path.stat().st_size // 2)


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


DAMAGE = {
    "truncated": truncate,
    "one bit flipped": flip,
    "missing": lambda path: path.unlink(),
    "empty": lambda path: path.write_bytes(b""),
}


@pytest.mark.parametrize(
    ("file", "damage"),
    [
        ("components/0000-agent/state.pt", "one bit flipped"),
        ("seal.json", "truncated"),
        *(
            pytest.param(file, damage, marks=pytest.mark.slow)
            for file, damage in (
                *(("components/0000-agent/state.pt", d) for d in DAMAGE if "flipped" not in d),
                ("manifest.json", "one bit flipped"),
                ("seal.json", "one bit flipped"),
            )
        ),
    ],
)
def test_a_torn_checkpoint_is_named_and_the_one_before_is_used(stopped, make, caplog, damage, file):
    torn = newest(stopped)
    DAMAGE[damage](torn / file)
    trainer = make(total_steps=200)
    path = trainer.resume()
    assert path.name == "checkpoint-000000000100"
    assert trainer.env_steps == 100
    assert any(torn.name in r.message and r.levelno == logging.WARNING for r in caplog.records)
    assert not torn.exists()
    assert torn.with_name(torn.name + ".torn").exists()
    trainer.run()
    trainer.close()
    assert newest(stopped).name == "checkpoint-000000000200.torn"
    path, env_steps = load_components(stopped, {"agent": trainer.agent})
    assert (path.name, env_steps) == (torn.name, 200)  # written anew


def test_when_none_is_whole_every_reason_is_given(stopped, make):
    for path in (stopped / "checkpoints").iterdir():
        truncate(path / "components/0000-agent/state.pt")
    trainer = make()
    with pytest.raises(
        ValueError,
        match=r"(?s)expected a checkpoint that is whole.*200: .*state.pt: expected .*100: .*state.pt",
    ):
        trainer.resume()
    trainer.close()


def test_another_schema_version_is_named(stopped, make, monkeypatch):
    monkeypatch.setattr(files, "SCHEMA_VERSION", 3)
    trainer = make()
    with pytest.raises(ValueError, match="expected schema version 3, got 2"):
        trainer.resume()
    trainer.close()


def test_a_log_that_ends_too_early_leads_to_the_checkpoint_before(stopped, make, caplog):
    segment = stopped / "transitions" / "segment_000000.bin"
    os.truncate(segment, segment.stat().st_size - 5)
    trainer = make()
    assert trainer.resume().name == "checkpoint-000000000100"
    assert "expected 200 records, got 199" in caplog.text
    trainer.close()


def test_a_damaged_transition_costs_nothing_but_itself(stopped, make, caplog):
    segment = stopped / "transitions" / "segment_000000.bin"
    intact = make("other")
    intact.run()
    content = bytearray(segment.read_bytes())
    size = len(content) // 200
    content[70 * size + 3] ^= 16
    segment.write_bytes(content)
    trainer = make()
    assert trainer.resume().name == "checkpoint-000000000200"
    assert "1 of the stored transitions are damaged on disk (records 70)" in caplog.text
    whole, resumed = intact.replay.storage[:], trainer.replay.storage[:]
    kept = [i for i in range(200) if i != 70]
    assert (whole[kept] == resumed[kept]).all()
    assert (resumed[70].exclude("index") == whole[69].exclude("index")).all()
    trainer.close()
    intact.close()


def test_a_checkpoint_does_not_grow_with_the_buffer(make, tmp_path):
    def size(run_dir, **changes):
        trainer = make(
            run_dir,
            evaluation={"every": 0, "episodes": 1, "final_episodes": 1, "slots": 1},
            **changes,
        )
        trainer.run()
        trainer.close()
        return sum(p.stat().st_size for p in newest(tmp_path / run_dir).rglob("*") if p.is_file())

    quick = {
        "warmup_steps": 40,
        "updates_per_step": 0.05,
        "checkpoint": CheckpointSettings(every=0),
    }
    small, large = size("small", total_steps=100, **quick), size("large", total_steps=1000, **quick)
    assert abs(small - large) < 64  # digits of the counters


def test_a_buffer_that_wrapped_around_is_restored_as_a_ring(make):
    capacity = {"buffer_capacity": 60}
    whole = make("whole", total_steps=300, **capacity)
    whole.run()
    first = make("broken", total_steps=200, **capacity)
    first.run()
    first.close()
    second = make("broken", total_steps=300, **capacity)
    second.resume()
    assert len(second.replay) == 60
    assert (second.replay.storage[:] == first.replay.storage[:]).all()
    second.run()
    assert (second.replay.storage[:] == whole.replay.storage[:]).all()
    assert same_state(dict(whole.agent.state_dict()), dict(second.agent.state_dict()))
    whole.close()
    second.close()


@pytest.mark.parametrize("every", [100, 0])
def test_the_log_on_disk_is_bounded_by_what_room_is_asked_for(make, every):
    trainer = make(total_steps=400, buffer_capacity=60, checkpoint=CheckpointSettings(every=every))
    trainer.store.log._segment_bytes = 40 * 60
    one_round, on_disk = trainer._round, []

    def looking():
        one_round()
        on_disk.append(len(list(trainer.store.log.folder.glob("segment_*"))))

    trainer._round = looking
    trainer.run()
    trainer.close()
    per_segment, room = trainer.store.log._per_segment, kept_on_disk(trainer.settings)
    assert 1 < per_segment < 60
    assert room // per_segment - 2 <= max(on_disk) <= room // per_segment + 2


def run_after_crash(make, steps, **changes):
    """A run that dies without a word 40 steps after its checkpoint at step 100."""
    trainer = make(total_steps=steps, checkpoint=CheckpointSettings(every=100), **changes)
    real, rounds = trainer._round, iter(range(7))

    def dying():
        if next(rounds, None) is None:
            raise RuntimeError("power is gone")
        real()

    trainer._round = dying
    with pytest.raises(RuntimeError, match="power is gone"):
        trainer.run()
    assert trainer.env_steps == 7 * EPISODE_STEPS
    trainer.close()
    return trainer


def test_what_a_simulation_made_after_the_checkpoint_is_made_again_and_kept(make, caplog):
    dead = run_after_crash(make, 200)
    resumed = make(total_steps=200)
    resumed.resume()
    assert "40 transitions were stored after the checkpoint" in caplog.text
    (tail,) = resumed.store.log.folder.glob("tail_000000000100_*.bin")
    resumed.run()
    record = resumed.store.log._record.itemsize
    again = (resumed.store.log.folder / "segment_000000.bin").read_bytes()[
        100 * record : 140 * record
    ]
    assert tail.read_bytes() == again
    assert (resumed.replay.storage[:140] == dead.replay.storage[:140]).all()
    resumed.close()


def test_what_hardware_made_after_the_checkpoint_is_learned_from_again(make_trainer, caplog):
    """An environment without a state: all transitions stay, and the agent is the one that the crash destroyed."""
    dead = run_after_crash(make_trainer, 200)
    lost = {
        name: value.clone()
        for name, value in dead.agent.state_dict().items()
        if isinstance(value, torch.Tensor)
    }
    resumed = make_trainer(total_steps=200)
    resumed.resume()
    assert not resumed.collection.can_continue
    assert "40 transitions were stored after the checkpoint" in caplog.text
    assert (resumed.env_steps, resumed.store.pending) == (100, 40)
    while resumed.store.pending:
        resumed._round()
    assert resumed.env_steps == 140
    assert (resumed.replay.storage[:] == dead.replay.storage[:]).all()
    assert all(torch.equal(lost[name], resumed.agent.state_dict()[name]) for name in lost)
    resumed.run()
    assert resumed.env_steps == len(resumed.replay) == 200
    resumed.close()


def test_a_run_is_not_started_over_another(stopped, make):
    trainer = make()
    with pytest.raises(FileExistsError, match="expected a directory without a run"):
        trainer.run()
    trainer.close()


def test_two_processes_do_not_train_in_one_directory(stopped, make):
    first = make()
    first.resume()
    with pytest.raises(BlockingIOError, match="another process is training"):
        make()
    first.close()
    second, third = make(), make()
    second.resume()
    with pytest.raises(BlockingIOError, match="another process is training"):
        third.resume()
    second.close()
    third.close()


def test_what_a_kill_left_half_written_is_swept_away(stopped, make):
    folder = stopped / "checkpoints"
    for name in (".checkpoint-000000000300", ".checkpoint-000000000200.stage-1"):
        (folder / name / "components").mkdir(parents=True)
    trainer = make()
    assert trainer.resume().name == "checkpoint-000000000200"
    trainer.close()
    assert not list(folder.glob(".*"))


class Bomb:
    """A pickle that leaves a file behind where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("legacy", [True, False])
def test_loading_executes_nothing(stopped, make, tmp_path, legacy):
    """Even if somebody who knows the format puts a pickle in and seals the checkpoint again."""
    path, trap = newest(stopped), tmp_path / "trap"
    state = path / "components/0000-agent/state.pt"
    if legacy:
        state.write_bytes(pickle.dumps(Bomb(trap)))
    else:
        torch.save({"weight": Bomb(trap)}, state)
    note = files.read_note(path)
    (path / "seal.json").unlink()
    files.seal(path, note)
    trainer = make()
    with pytest.raises(Exception, match=r"(?i)weights.only"):
        trainer.resume()
    trainer.close()
    assert not trap.exists()
