"""One number per metric, resumed files that go on, and W&B's own environment variables."""

import time

import pytest

from rrl.trainers.loggers import CSVLogger, TensorBoardLogger, WandbLogger, read_metrics
from wandb_file import read


@pytest.fixture(autouse=True)
def _no_wandb_variables(monkeypatch):
    for name in ("WANDB_MODE", "WANDB_DISABLED", "WANDB_PROJECT"):
        monkeypatch.delenv(name, raising=False)


def logged(logger, run_dir, rows, env_steps=0, config=None):
    run_dir.mkdir(parents=True, exist_ok=True)
    logger.start(run_dir, config or {}, env_steps)
    for steps, values in rows:
        logger.log(values, steps)
    logger.flush()
    logger.finish()


def test_the_file_is_tidy_and_keeps_every_digit(tmp_path):
    logged(CSVLogger(), tmp_path, [(0, {"a/b": 0.1}), (5, {"a/b": 1 / 3, "c, d": float("nan")})])
    lines = (tmp_path / "metrics.csv").read_text().splitlines()
    assert lines[:2] == ["env_steps,metric,value", "0,a/b,0.1"]
    found = read_metrics(tmp_path)
    assert found["a/b"] == [(0, 0.1), (5, 1 / 3)]
    assert str(found["c, d"]) == "[(5, nan)]"


def test_a_resumed_file_goes_on_after_its_checkpoint(tmp_path):
    logged(CSVLogger(), tmp_path, [(step, {"a": float(step)}) for step in (0, 5, 10)])
    with (tmp_path / "metrics.csv").open("a") as file:
        file.write("10,a")  # torn by a crash
    assert read_metrics(tmp_path)["a"] == [(0, 0.0), (5, 5.0), (10, 10.0)]
    logged(CSVLogger(), tmp_path, [(7, {"a": 7.5})], env_steps=5)
    assert read_metrics(tmp_path)["a"] == [(0, 0.0), (5, 5.0), (7, 7.5)]
    logged(CSVLogger(), tmp_path, [(1, {"a": 1.0})])
    assert read_metrics(tmp_path)["a"] == [(1, 1.0)]


@pytest.mark.parametrize("name", ["train/a,b", 'train/say "x"', "train/ü\u2028x"])
def test_a_metric_keeps_its_name(tmp_path, name):
    logger = CSVLogger()
    for step in (0, 5):  # the second time as a run that is resumed
        logger.start(tmp_path, {}, step)
        logger.log({name: 1.0}, step + 1)
        logger.finish()
    assert read_metrics(tmp_path) == {name: [(1, 1.0), (6, 1.0)]}


def test_a_final_evaluation_that_is_made_again_is_not_there_twice(tmp_path):
    logged(CSVLogger(), tmp_path, [(10, {"a": 1.0, "final/b/success": 0.5})])
    logged(CSVLogger(), tmp_path, [(10, {"final/b/success": 0.75})], env_steps=10)
    found = read_metrics(tmp_path)
    assert (found["a"], found["final/b/success"]) == ([(10, 1.0)], [(10, 0.75)])


def test_a_run_without_a_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"expected metrics\.csv, got none"):
        read_metrics(tmp_path)


def test_tensorboard_holds_the_scalars(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    logged(TensorBoardLogger(), tmp_path, [(5, {"a/b": 0.5}), (10, {"a/b": 1.0})])
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    assert [(e.step, e.value) for e in events.Scalars("a/b")] == [(5, 0.5), (10, 1.0)]


@pytest.mark.parametrize("checkpoint", [0, 5])
def test_tensorboard_goes_on_after_the_checkpoint(tmp_path, checkpoint):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    steps = (0, 5, 10)
    logged(TensorBoardLogger(), tmp_path, [(step, {"a": 0.0}) for step in steps])
    again = [(step, {"a": 1.0}) for step in steps if step > checkpoint or not checkpoint]
    logged(TensorBoardLogger(), tmp_path, again, env_steps=checkpoint)
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    kept = [(step, 0.0) for step in steps if step <= checkpoint and checkpoint]
    expected = kept + [(step, values["a"]) for step, values in again]
    assert [(e.step, e.value) for e in events.Scalars("a")] == expected


def test_an_offline_run_is_named_and_grouped_by_its_directory(tmp_path):
    run_dir = tmp_path / "lr-3" / "seed-2"
    logged(WandbLogger(name="mine"), run_dir, [(5, {"a/b": 0.5})], config={"x": 1})
    (folder,) = run_dir.glob("wandb/offline-run-*")
    patience = time.monotonic() + 30  # W&B's own process writes the file
    while not (found := read(folder)).rows("a/b") and time.monotonic() < patience:
        time.sleep(0.1)
    assert (found.run.run_group, found.run.display_name) == ("lr-3", "mine seed-2")
    assert found.config["x"] == 1
    assert found.rows("a/b")[0]["env_steps"] == 5


@pytest.mark.parametrize(
    "variables", [{"WANDB_MODE": "disabled"}, {"WANDB_DISABLED": "true"}, {"WANDB_MODE": "dryrun"}]
)
def test_wandbs_own_switches_stand_above_the_configuration(
    tmp_path, monkeypatch, caplog, variables
):
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("WANDB_PROJECT", "other")
    logged(WandbLogger(), tmp_path / "run", [(5, {"a": 0.5})])
    offline = "dryrun" in variables.values()
    assert bool(list(tmp_path.glob("run/wandb/offline-run-*"))) == offline
    assert ("asks for disabled" in caplog.text) != offline
    assert "WANDB_PROJECT not used" in caplog.text


def test_wandb_mode_online_is_tried(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("WANDB_MODE", "online")
    monkeypatch.setenv("WANDB_BASE_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("WANDB_API_KEY", "0" * 40)
    monkeypatch.setattr(WandbLogger, "CONNECT_SECONDS", 1.0)
    logged(WandbLogger(), tmp_path / "run", [(5, {"a": 0.5})])
    assert "asks for online" in caplog.text
    assert "logging offline" in caplog.text
