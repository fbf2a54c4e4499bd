"""Runs in the pool: those that drive a robot never do so side by side."""

import os
import sys
import threading
import time
from itertools import groupby

import pytest

from realtime_runs import wait_for
from robot_project import FEW, write_robot_project
from rrl.trainers.cli.compose import compose
from rrl.trainers.console import Output
from rrl.trainers.launch.job import Job, one_seed
from rrl.trainers.launch.pool import launch
from rrl.trainers.storage.files import lock
from rrl.trainers.training.realtime.hand_over import FOLDER


@pytest.fixture
def project(tmp_path, monkeypatch):
    """The folder of a project with a robot, which is the working directory."""
    write_robot_project(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("carriage", None)


def seeds(project):
    config = compose(FEW, project / "configs")
    return [Job(project / f"seed-{seed}", one_seed(config, seed)) for seed in (0, 1)]


@pytest.mark.parametrize(("workers", "got"), [(None, "null"), (2, "2")])
def test_seeds_side_by_side_on_a_robot_are_refused(project, workers, got):
    with pytest.raises(ValueError, match=f"expected 1, because 2 runs drive .* got {got}; set"):
        launch(seeds(project), "local", workers, Output(), "again")
    assert not (project / "calls.txt").exists()
    assert not list(project.glob("seed-*"))


@pytest.mark.slow
def test_seeds_on_a_robot_run_one_after_the_other(project):
    first, second = jobs = seeds(project)
    (first.path / FOLDER).mkdir(parents=True)
    acting = lock(first.path / FOLDER)  # as a process does that drives the robot
    waited = []

    def go_on_driving():
        wait_for(lambda: first.finished)
        time.sleep(1.0)
        waited.append(not second.path.exists())
        os.close(acting)

    thread = threading.Thread(target=go_on_driving)
    thread.start()
    ending = launch(jobs, "local", 1, Output(), "again")
    thread.join()
    assert waited == [True]
    assert len(ending.done) == 2
    drivers = [pid for pid, _ in groupby((project / "processes.txt").read_text().split())]
    assert len(drivers) == len(set(drivers)) == 2
