"""The log of transitions: whatever was appended is read back, and what was damaged is known."""

import errno
import json
import os

import pytest
import torch
from tensordict import TensorDict

from rrl.trainers.storage.transition_log import TransitionLog


def transitions(first, number):
    """Recognizable transitions: every field tells the record's number."""
    n = torch.arange(first, first + number)
    return TensorDict(
        {
            "observation": n[:, None].float().expand(number, 3).contiguous(),
            "action": n[:, None].double(),
            ("next", "done"): (n % 2 == 1)[:, None],
        },
        [number],
    )


def filled(folder, number=25, step=4, segment_records=10):
    log = TransitionLog(folder, segment_bytes=segment_records * RECORD_BYTES)
    for first in range(0, number, step):
        log.append(transitions(first, min(step, number - first)))
    return log


RECORD_BYTES = 3 * 4 + 8 + 1 + 4


def assert_reads(log, first, last):
    read, damaged = log.read(first, last)
    assert not damaged
    assert (read == transitions(first, last - first)).all()


def test_what_was_appended_is_read_back_across_segments_and_after_reopening(tmp_path):
    log = filled(tmp_path)
    assert log.count == 25
    assert len(list(tmp_path.glob("segment_*.bin"))) == 3
    for reopened in (log, TransitionLog(tmp_path)):
        assert_reads(reopened, 0, 25)
        assert_reads(reopened, 7, 21)
    reopened.append(transitions(25, 8))
    assert_reads(reopened, 0, 33)


@pytest.mark.parametrize("count", [0, 4, 10])
@pytest.mark.parametrize("how", ["cut", "forget"])
def test_what_is_gone_need_not_be_synced(tmp_path, how, count):
    log = filled(tmp_path)
    getattr(log, how)(count)
    log.sync()
    assert_reads(TransitionLog(tmp_path), *((0, count) if how == "cut" else (count, 25)))


def test_the_format_is_plain(tmp_path):
    filled(tmp_path)
    schema = json.loads((tmp_path / "schema.json").read_text())
    assert schema["fields"] == [
        [["action"], "float64", [1]],
        [["next", "done"], "bool", [1]],
        [["observation"], "float32", [3]],
    ]
    assert (tmp_path / "segment_000000.bin").stat().st_size == 10 * RECORD_BYTES


@pytest.mark.parametrize("byte", [0, 5, RECORD_BYTES - 1])
@pytest.mark.parametrize("record", [0, 9, 10, 24])
def test_a_flipped_bit_is_found_in_its_record(tmp_path, record, byte):
    log = filled(tmp_path)
    path = tmp_path / f"segment_{record // 10:06d}.bin"
    content = bytearray(path.read_bytes())
    content[record % 10 * RECORD_BYTES + byte] ^= 4
    path.write_bytes(content)
    _, damaged = log.read(0, 25)
    assert record in damaged
    assert set(damaged) <= {
        record,
        record + 1,
    }  # a flipped checksum also disagrees with the next record's


def test_a_torn_record_does_not_count(tmp_path):
    filled(tmp_path)
    last = tmp_path / "segment_000002.bin"
    os.truncate(last, last.stat().st_size - 1)
    log = TransitionLog(tmp_path)
    assert log.count == 24
    log.cut(24)
    log.append(transitions(24, 3))
    assert_reads(log, 0, 27)


@pytest.mark.parametrize("count", [0, 3, 10, 17, 20, 24])
def test_cutting_keeps_the_tail(tmp_path, count):
    log = filled(tmp_path)
    whole = b"".join(p.read_bytes() for p in sorted(tmp_path.glob("segment_*.bin")))
    tail = log.cut(count)
    assert tail.read_bytes() == whole[count * RECORD_BYTES :]
    assert log.count == TransitionLog(tmp_path).count == count
    assert log.cut(count) is None
    log.append(transitions(count, 25 - count))
    assert b"".join(p.read_bytes() for p in sorted(tmp_path.glob("segment_*.bin"))) == whole
    log.cut(count)
    assert len(list(tmp_path.glob("tail_*.bin"))) == 2


def test_old_segments_are_forgotten_whole(tmp_path):
    log = filled(tmp_path)
    log.forget(19)
    assert sorted(p.name for p in tmp_path.glob("segment_*.bin")) == [
        "segment_000001.bin",
        "segment_000002.bin",
    ]
    assert_reads(log, 10, 25)
    with pytest.raises(ValueError, match=r"segment_000000.bin: expected record 10, got the end"):
        log.read(5, 25)
    assert TransitionLog(tmp_path).count == 25


def test_other_entries_are_refused(tmp_path):
    log = filled(tmp_path)
    with pytest.raises(
        ValueError, match=r"transitions: expected .*action.*next.*done.*observation"
    ):
        log.append(transitions(25, 1).exclude("action"))
    wider = transitions(25, 1)
    wider["action"] = torch.zeros(1, 2, dtype=torch.float64)
    with pytest.raises(ValueError, match="action"):
        log.append(wider)
    assert log.count == 25


def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch):
    log = filled(tmp_path)
    real = os.pwrite

    def half(descriptor, data, offset):
        real(descriptor, data[: len(data) // 2], offset)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwrite", half)
    with pytest.raises(OSError, match="25 transitions before it are whole"):
        log.append(transitions(25, 3))
    monkeypatch.undo()
    assert TransitionLog(tmp_path).count == log.count == 25
    log.append(transitions(25, 3))
    assert_reads(TransitionLog(tmp_path), 0, 28)


def test_a_schema_that_cannot_be_read_is_named(tmp_path):
    filled(tmp_path)
    (tmp_path / "schema.json").write_text("{}")
    with pytest.raises(ValueError, match=r"schema.json: expected a description of records"):
        TransitionLog(tmp_path)


def test_a_reader_sees_what_another_process_has_appended_since(tmp_path):
    reader = TransitionLog(tmp_path)
    assert reader.refresh() == 0
    writer = TransitionLog(tmp_path, segment_bytes=10 * RECORD_BYTES)
    for first in range(0, 24, 8):
        writer.append(transitions(first, 8))
        assert reader.refresh() == first + 8
        assert_reads(reader, first, first + 8)


def test_what_another_process_has_appended_is_on_disk_when_asked_for(tmp_path, monkeypatch):
    filled(tmp_path).close()
    reader, synced = TransitionLog(tmp_path), []
    monkeypatch.setattr("rrl.trainers.storage.transition_log.fsync", synced.append)
    reader.sync_all()
    assert set(tmp_path.glob("segment_*.bin")) | {tmp_path} == set(synced)
