"""A project of its own with a fast environment and a small experiment."""

from functools import partial

import pytest

from experiment_project import write_project
from rrl.trainers.cli.compose import compose as compose_config
from rrl.trainers.console import Output
from rrl.trainers.experiments.reproduce import reproduce
from rrl.trainers.experiments.spec import load_experiments


@pytest.fixture
def project(tmp_path, monkeypatch):
    """The project's folder, which is the working directory; write experiments with :func:`write`."""
    write_project(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


@pytest.fixture
def folders(project):
    return [project / "configs"]


@pytest.fixture
def compose(project):
    return partial(compose_config, folder=project / "configs")


@pytest.fixture
def run(project, folders, compose):
    """``rrl reproduce`` in this process, its runs in processes of their own; returns the report and what was said."""

    def call(*names, **changes):
        with (project / "said.txt").open("w") as file:
            again = " ".join(["rrl reproduce", *names])
            report = reproduce(names, changes, compose, folders, Output(file=file), again)
        return report, (project / "said.txt").read_text()

    return call


@pytest.fixture
def experiments(folders):
    return lambda *names: load_experiments(names, folders)
