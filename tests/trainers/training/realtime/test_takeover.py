"""Whoever takes over from a learner or an acting process goes on where that one was."""

import os
import shutil
import signal
import threading
from functools import partial
from multiprocessing import get_context

import pytest
import torch

from realtime_runs import (
    Paced,
    acted,
    acting_pid,
    learn,
    learn_and_be_killed,
    wait_for,
)
from rrl.robot import RobotFault
from rrl.trainers.settings import CheckpointSettings
from rrl.trainers.storage.transition_log import TransitionLog
from rrl.trainers.training.interruption import Interrupted
from rrl.trainers.training.realtime.hand_over import HandOver
from rrl.trainers.training.realtime.records import read_usable
from runs import run

SLOW = {"realtime": {"period": 0.02}}


class Counting(torch.nn.Module):
    """Exploration that says in its actions how far it is annealed, and what it draws."""

    in_keys, out_keys = ["action"], ["action"]

    def __init__(self, spec):
        super().__init__()
        self.frames = 0

    def step(self, frames=1):
        self.frames += frames

    def forward(self, tensordict):
        action = torch.tensor([[self.frames / 1000, float(torch.rand(()))]])
        return tensordict.set("action", action)


class Resting(Paced):
    """Takes a minute for its second reset, and writes down what it is asked to."""

    def __init__(self, folder, num_envs=1):
        super().__init__(num_envs)
        self.folder, self.steps_taken = folder, 0

    def _step(self, tensordict):
        self.steps_taken += 1
        return super()._step(tensordict)

    def _reset(self, tensordict=None, **kwargs):
        if self.steps_taken:
            (self.folder / "resetting").touch()
            threading.Event().wait(60)
        return super()._reset(tensordict, **kwargs)

    def stop(self):
        (self.folder / "stopped").touch()


class Blinking(Paced):
    """Does not see its goal in its third reset."""

    ended = 0

    def _step(self, tensordict):
        out = super()._step(tensordict)
        self.ended += int(out["done"].any())
        return out

    def _reset(self, tensordict=None, **kwargs):
        out = super()._reset(tensordict, **kwargs)
        if self.ended == 2:
            self.ended += 1  # the next one is whole
            out["goal"] = torch.full_like(out["goal"], float("nan"))
        return out


class SwitchedOff(Paced):
    """Does not answer after its 60th step, until there is a file."""

    def __init__(self, file, num_envs=1):
        super().__init__(num_envs)
        self.file, self.steps_taken = file, 0

    def _step(self, tensordict):
        self.steps_taken += 1
        if self.steps_taken > 60 and not self.file.exists():
            raise RobotFault("silent")
        return super()._step(tensordict)


def kill_the_process(trainer):
    os.kill(acting_pid(trainer.run_dir), signal.SIGKILL)
    wait_for(lambda: not HandOver(trainer.run_dir / "realtime").is_alive())


@pytest.mark.slow
def test_a_process_that_follows_another_explores_as_that_one_would(make):
    trainer = make(total_steps=200, exploration=Counting, **SLOW)
    one_round = trainer._round

    def kill_at_60():
        if trainer.env_steps == 60:
            kill_the_process(trainer)
        one_round()

    trainer._round = kill_at_60
    with trainer, pytest.raises(RuntimeError, match="the acting process died"):
        trainer.run()
    second = make(total_steps=200, exploration=Counting, **SLOW)
    second.resume()
    data = acted(run(second).run_dir)
    in_time = data["timing", "missed"].flatten() == 0
    annealed, drawn = data["action"][:, 0] * 1000, data["action"][:, 1]
    assert (annealed - torch.arange(200))[in_time].abs().max() < 5
    assert len(drawn[in_time].unique()) == in_time.sum()


@pytest.mark.slow
def test_a_learner_that_died_in_a_pause_leaves_none_behind(make, tmp_path, caplog):
    def pause(trainer):
        trainer.person.pause()
        threading.Event().wait(0.5)

    changes = {**SLOW, "total_steps": 240}  # a busy learner pauses late
    learn_and_be_killed(make, 60, pause, **changes)
    assert len(acted(tmp_path / "run")) < 240
    learner = threading.Thread(target=learn, args=(make,), kwargs=changes, daemon=True)
    learner.start()
    wait_for(lambda: len(acted(tmp_path / "run")) == 240)
    wait_for(lambda: not HandOver(tmp_path / "run/realtime").is_alive())
    learner.join(60)
    assert not learner.is_alive()  # nor does it disturb the next test
    assert "was paused when the learner before ended: it goes on" in caplog.text


def test_a_robot_that_is_being_reset_is_stopped_when_its_process_is_told_to_end(make, tmp_path):
    trainer = make(base=partial(Resting, tmp_path))

    def play():
        with pytest.raises(RuntimeError, match="the acting process died"):
            trainer.run()

    thread = threading.Thread(target=play, daemon=True)
    thread.start()
    wait_for((tmp_path / "resetting").exists)
    (tmp_path / "stopped").unlink(missing_ok=True)
    os.kill(acting_pid(trainer.run_dir), signal.SIGTERM)
    wait_for(lambda: not HandOver(trainer.run_dir / "realtime").is_alive(), 30.0)
    assert (tmp_path / "stopped").exists()
    thread.join(60)
    assert not thread.is_alive()
    trainer.close()
    said = (trainer.run_dir / "realtime/log.txt").read_text()
    assert "the robot keeps no pace of its own" in said


def test_a_robot_that_is_blind_at_a_reset_costs_an_episode(make, caplog):
    trainer = run(make(base=Blinking))
    data, stored = acted(trainer.run_dir), trainer.replay[:]
    assert all(v.isfinite().all() for v in stored.values(True, True) if v.is_floating_point())
    assert torch.equal(stored["goal"], data["goal"])
    assert data["timing", "first"].flatten()[40:42].tolist() == [True, True]
    assert caplog.text.count("goal: NaN or infinity") == 1


@pytest.mark.slow
def test_a_record_that_is_not_finite_is_replaced_by_its_neighbor(make, tmp_path, caplog):
    data = acted(run(make()).run_dir)
    log, bad = TransitionLog(tmp_path / "other"), data.clone()
    bad["goal"][40] = torch.nan
    log.append(bad)
    for _ in range(2):  # it stays in the log for ever
        found = read_usable(log, 20, 60, ["end_effector_position", "goal"])
        assert torch.equal(found["goal"][20], data["goal"][39])
        assert torch.equal(found["goal"][21:], data["goal"][41:60])
        assert found["timing", "first"].flatten()[20:22].tolist() == [True, True]
    assert caplog.text.count("1 of the acting process's records (40)") == 2


@pytest.mark.slow
def test_a_run_stops_though_its_robot_is_switched_off_and_goes_on_later(make, tmp_path):
    trainer = make(base=partial(SwitchedOff, tmp_path / "on"), realtime={"retry": 0.1})
    process = HandOver(trainer.run_dir / "realtime")

    def stop_in_fault():
        log = TransitionLog(trainer.run_dir / "realtime/transitions")
        wait_for(lambda: log.refresh() == 60)
        trainer.person.stop()

    threading.Thread(target=stop_in_fault, daemon=True).start()
    with pytest.raises(Interrupted):
        trainer.run()
    assert trainer.env_steps <= 60
    assert not process.is_alive()
    (tmp_path / "on").touch()
    trainer.resume()
    data = acted(run(trainer).run_dir)
    assert trainer.env_steps == len(data) == 120
    assert torch.equal(trainer.replay[:]["action"], data["action"])


def test_the_process_does_not_outlive_a_learner_that_is_stopped_at_once(make, tmp_path):
    def twice(trainer):
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGINT)

    changes = {**SLOW, "total_steps": 1000}
    child = get_context("fork").Process(target=learn, args=(make, 40, twice), kwargs=changes)
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGINT
    wait_for(lambda: not HandOver(tmp_path / "run/realtime").is_alive(), 30.0)


def test_a_trainer_that_cannot_be_made_leaves_no_process(make, tmp_path):
    def agent(**_):
        raise ValueError("no such network")

    with pytest.raises(ValueError, match="no such network"):
        make(agent=agent)
    assert not HandOver(tmp_path / "run/realtime").is_alive()


@pytest.mark.slow
def test_a_second_trainer_beside_one_that_has_not_begun_is_refused(make):
    with make(), pytest.raises(BlockingIOError, match="got one, of this or another process"):
        make()
    make().close()


@pytest.mark.slow
def test_a_robot_makes_no_step_again_whose_record_is_gone(make, tmp_path):
    run(make(total_steps=60))
    shutil.rmtree(tmp_path / "run/realtime")
    trainer = make(total_steps=80)
    trainer.resume()
    with trainer, pytest.raises(ValueError, match="expected the 60 transitions that the run has"):
        trainer.run()
    assert TransitionLog(tmp_path / "run/realtime/transitions").count == 0


@pytest.mark.slow
def test_a_run_goes_on_where_the_processs_log_has_lost_its_last_records(make, tmp_path, caplog):
    changes = {**SLOW, "total_steps": 120, "checkpoint": CheckpointSettings(every=60)}
    learn_and_be_killed(make, 100, kill_the_process, **changes)
    log = TransitionLog(tmp_path / "run/realtime/transitions")
    log.cut(95)  # as a loss of power does
    log.close()
    trainer = learn(make, **changes)
    data = acted(tmp_path / "run")
    assert trainer.env_steps == len(data) == 120
    assert torch.equal(trainer.replay[:]["action"], data["action"])
    assert "20 transitions were stored after the checkpoint; they are learned from" in caplog.text
    assert list((tmp_path / "run/transitions").glob("tail_000000000080_*.bin"))


@pytest.mark.slow
def test_a_damaged_record_is_replaced_by_its_neighbor(make, tmp_path):
    run_dir = tmp_path / "run"
    learn_and_be_killed(make, 40, **SLOW)
    wait_for(lambda: len(acted(run_dir)) >= 80)
    log = TransitionLog(run_dir / "realtime" / "transitions")
    with (log.folder / "segment_000000.bin").open("r+b") as file:
        file.seek(75 * log._record.itemsize + log._record.fields['["action"]'][1])
        file.write(b"\x55\xaa")
    trainer = learn(make, **SLOW)
    data, damaged = log.read(0, 120)
    assert damaged == [75]
    stored = trainer.replay[:]
    assert len(stored) == 120
    sound = torch.arange(120) != 75
    assert torch.equal(stored["action"][sound], data["action"][sound])
    assert torch.equal(stored["goal"][75], data["goal"][74])
    assert stored["next", "done"].flatten()[74:77].tolist() == [True, True, False]


@pytest.mark.slow
def test_a_longer_run_goes_on_and_no_episode_comes_again(make, tmp_path):
    learn_and_be_killed(make, 40, kill_the_process, total_steps=240, **SLOW)
    learn_and_be_killed(make, 80, total_steps=240, **SLOW)
    assert HandOver(tmp_path / "run/realtime").is_alive()
    trainer = learn(make, total_steps=320, **SLOW)
    data = acted(tmp_path / "run")
    assert trainer.env_steps == len(data) == 320
    assert torch.equal(trainer.replay[:]["action"], data["action"])
    starts = data["goal"][data["timing", "first"].flatten()]
    assert len(starts.unique(dim=0)) == len(starts) >= 16
