"""Runs in wall-clock time whose learners are killed."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tensordict import TensorDict

from rrl.trainers import Trainer
from rrl.trainers.storage.transition_log import TransitionLog
from toy_envs import PointMass

PERIOD = 0.01


class Paced(PointMass):
    """A point that says how long its steps last."""

    control_period = PERIOD

    def __init__(self, num_envs=1, **arguments):
        super().__init__([num_envs], **arguments)


def acted(run_dir: Path) -> TensorDict:
    """What the acting process has stored so far."""
    log = TransitionLog(run_dir / "realtime" / "transitions")
    data, damaged = log.read(0, log.count)
    assert not damaged
    return data


def acting_pid(run_dir: Path) -> int:
    return int((run_dir / "realtime" / "pid").read_text())


def wait_for(condition: Callable[[], Any], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def learn(make: Callable[..., Trainer], until=None, then=None, **changes: Any) -> Trainer:
    """Begin or resume a run; the learner kills itself after so many steps, and after ``then``."""
    with make(**changes) as trainer:
        if trainer.checkpoints.exist():
            trainer.resume()
        one_round = trainer._round

        def dying():
            one_round()
            if until is not None and trainer.env_steps >= until:
                if then is not None:
                    then(trainer)
                os.kill(os.getpid(), signal.SIGKILL)

        trainer._round = dying
        trainer.run()
        return trainer


def learn_and_be_killed(make: Callable[..., Trainer], until: int, then=None, **changes: Any):
    child = get_context("fork").Process(target=learn, args=(make, until, then), kwargs=changes)
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
