"""Runs in wall-clock time, of which no process is left behind."""

import os
import signal
from dataclasses import replace

import pytest

from realtime_runs import Paced
from rrl.trainers.settings import (
    AcceptanceSettings,
    CheckpointSettings,
    EvaluationSettings,
    RealTimeSettings,
)
from rrl.trainers.training.realtime.hand_over import HandOver


@pytest.fixture(autouse=True)
def _nobody_left(tmp_path):
    """A test that fails leaves no process behind."""
    yield
    for pid in tmp_path.glob("*/realtime/pid"):
        if HandOver(pid.parent).is_alive():
            os.kill(int(pid.read_text()), signal.SIGKILL)


@pytest.fixture
def make(make_trainer, factory):
    """Builds a trainer of 100 Hz; 20 steps a round."""

    def make(run_dir="run", base=Paced, realtime=None, **changes):
        values = {
            "environment": replace(factory, base=base),
            "collection": "realtime",
            "realtime": RealTimeSettings(**{"priority": 0, "budget": 1.0, **(realtime or {})}),
            "total_steps": 120,
            "warmup_steps": 40,
            "controller_steps": 0,
            "n_step": 1,
            "evaluation": EvaluationSettings(every=0, final_episodes=2),
            "acceptance": AcceptanceSettings(enabled=False),
            "checkpoint": CheckpointSettings(every=40),
        }
        return make_trainer(run_dir, **{**values, **changes})

    return make
