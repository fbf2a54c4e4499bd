"""A logger that fails costs a run nothing but itself."""

import logging

import pytest

from rrl.trainers.loggers import CSVLogger, MetricsLogger, WandbLogger, read_metrics
from runs import run


class Broken(MetricsLogger):
    """Fails where it is told to."""

    def __init__(self, method):
        self.method, self.calls = method, []

    def _call(self, method):
        self.calls.append(method)
        if method == self.method:
            raise ConnectionError("the dashboard is gone")

    def start(self, run_dir, config, env_steps):
        self._call("start")

    def log(self, values, env_steps):
        self._call("log")

    def flush(self):
        self._call("flush")

    def finish(self):
        self._call("finish")


@pytest.mark.parametrize("method", ["start", "log", "flush", "finish"])
def test_a_broken_logger_is_said_once_and_left_alone(make_trainer, caplog, method):
    broken = Broken(method)
    trainer = make_trainer(loggers=[broken, CSVLogger()], total_steps=60, warmup_steps=40)
    trainer.run()
    trainer.close()
    (warning,) = [
        r for r in caplog.records if r.levelno == logging.WARNING and "Broken" in r.message
    ]
    assert (
        warning.message
        == "Broken failed (ConnectionError: the dashboard is gone); training goes on without it"
    )
    assert broken.calls.count(method) == 1
    steps = {step for step, _ in read_metrics(trainer.run_dir)["train/reward"]}
    assert steps == {20, 40, 60}


class Bare:
    """A logger of somebody who has not looked at ``MetricsLogger``."""

    def start(self, run_dir, config, env_steps):
        pass

    def log(self, values, env_steps):
        pass


def test_so_is_one_that_lacks_a_method(make_trainer, caplog):
    run(make_trainer(loggers=[Bare()], total_steps=60, warmup_steps=40))
    assert "Bare failed (AttributeError: 'Bare' object has no attribute 'flush')" in caplog.text


def test_wandb_goes_offline_when_its_server_cannot_be_reached(make_trainer, monkeypatch, caplog):
    monkeypatch.setenv("WANDB_BASE_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("WANDB_API_KEY", "0" * 40)
    monkeypatch.setattr(WandbLogger, "CONNECT_SECONDS", 1.0)
    trainer = make_trainer(
        loggers=[WandbLogger(online=True), CSVLogger()], total_steps=60, warmup_steps=40
    )
    trainer.run()
    trainer.close()
    assert "logging offline" in caplog.text
    assert list(trainer.run_dir.glob("wandb/offline-run-*/*.wandb"))
    assert "train/reward" in read_metrics(trainer.run_dir)
