"""A robot that does not do what it should: stopped within a period, every transition kept, gone on with."""

import logging
import threading
import time

import pytest

from plants import FAST, an_address, plant, plant_factory
from rrl.envs.plant import inject
from rrl.envs.plant.faults import KINDS
from rrl.robot import RobotFault
from rrl.trainers.settings import (
    AcceptanceSettings,
    CheckpointSettings,
    EvaluationSettings,
    RealTimeSettings,
)
from rrl.trainers.storage.transition_log import TransitionLog
from rrl.trainers.training.realtime.hand_over import HandOver

SECONDS, STEPS = 1.5, 400  # longer than a loaded machine may stand still and a reset is tried again


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_loop_stops_says_so_once_keeps_everything_and_goes_on(
    make_trainer, tmp_path, caplog, kind
):
    caplog.set_level(logging.INFO)
    address = an_address()
    trainer_of = {
        "environment": plant_factory(address, reset_patience=0.3),
        "collection": "realtime",
        "realtime": RealTimeSettings(retry=0.2),
        "total_steps": STEPS,
        "warmup_steps": 100,
        "n_step": 1,
        "evaluation": EvaluationSettings(every=0, episodes=1, final_episodes=1),
        "acceptance": AcceptanceSettings(enabled=False),
        "checkpoint": CheckpointSettings(every=0),
    }
    with plant(address, *FAST) as first, make_trainer(**trainer_of) as trainer:
        log = TransitionLog(trainer.run_dir / "realtime/transitions")
        ready = threading.Event()

        def spoil():
            while log.refresh() < 60:
                time.sleep(0.01)
            try:
                inject(address, kind, SECONDS)
            except RobotFault:
                assert kind == "die"
            if kind == "die":
                first.wait()
                with plant(address, *FAST):
                    ready.wait()

        thread = threading.Thread(target=spoil)
        thread.start()
        try:
            trainer.run()
        finally:
            ready.set()
            thread.join()
    said = [record.message for record in caplog.records]
    stops = [text for text in said if text.startswith("the robot is stopped")]
    backs = [text for text in said if text.startswith("the robot is back")]
    assert len(stops) == len(backs) >= 1
    data, damaged = log.read(0, log.refresh())
    assert len(data) == STEPS
    assert not damaged
    timing = data["timing"]
    assert timing["faults"].sum() >= 1
    after = (timing["faults"].flatten() > 0).nonzero().flatten()
    assert timing["first"].flatten()[after].all()  # a new episode
    stored, _ = trainer.store.log.read(0, trainer.store.log.count)
    assert (stored["action"] == data["action"]).all()
    pause = timing["time"].flatten().diff().max()
    assert pause >= 0.5 * SECONDS or kind == "die"
    assert not HandOver(trainer.run_dir / "realtime").is_alive()
