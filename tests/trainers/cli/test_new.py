"""``rrl new`` makes a project that trains as it stands, found from the directory that the user works in."""

import json
import os
import re
import subprocess
import sys
from importlib import import_module

import pytest
from torchrl.envs.utils import check_env_specs

from rrl.trainers.cli.new import create
from rrl.trainers.training.factories import locate

SMALL = [
    "trainer.total_steps=100",
    "trainer.warmup_steps=50",
    "algorithm=td3",
    "algorithm.agent.network.hidden=[16,16]",
    "trainer.batch_size=16",
    "trainer.evaluation.every=50",
    "trainer.evaluation.episodes=2",
    "trainer.evaluation.final_episodes=3",
    "trainer.acceptance.episodes=2",
    "trainer.checkpoint.every=50",
    "logger=csv",
]


def rrl(*arguments, cwd):
    return subprocess.run(
        [sys.executable, "-P", "-m", "rrl.trainers", *arguments]
        if sys.version_info >= (3, 11)
        else [sys.executable, "-m", "rrl.trainers", *arguments],
        cwd=cwd,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=280,
    )


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    cwd = tmp_path_factory.mktemp("user")
    result = rrl("new", "my_project", cwd=cwd)
    assert result.returncode == 0, result.stderr
    assert "rrl train env=my_project controller=my_project" in result.stdout
    return cwd / "my_project"


def test_a_new_project_trains_and_is_evaluated(project):
    result = rrl(
        "train",
        "env=my_project",
        "controller=my_project",
        "safety=step",
        "safety.step.size=0.5",
        *SMALL,
        cwd=project,
    )
    assert result.returncode == 0, result.stderr
    run_dir = next(project.glob("outputs/my_project-residual/*"))
    results = (run_dir / "results.json").read_text()
    assert set(json.loads(results)) == {"drift", "calm"}
    assert "safety/step" in (run_dir / "metrics.csv").read_text()
    again = rrl("evaluate", f"run={run_dir}", cwd=project)
    assert again.returncode == 0, again.stderr
    assert (run_dir / "results.json").read_text() == results


@pytest.mark.slow
def test_the_baseline_without_a_controller_fits_any_environment(project):
    result = rrl("train", "env=my_project", "arm=rl", *SMALL, cwd=project)
    assert result.returncode == 0, result.stderr


def test_every_placeholder_is_replaced(tmp_path):
    for path in create("reach", tmp_path):
        assert "__project__" not in path.read_text() + str(path)
        assert path.suffix in (".py", ".md", ".yaml")
    assert (tmp_path / "reach/configs/env/reach.yaml").is_file()


def test_what_the_readme_names_is_there(tmp_path):
    create("reach", tmp_path)
    text = (tmp_path / "reach/README.md").read_text()
    named = re.findall(r"\(`([\w.]+)`\)", text)
    assert "rrl.envs.gymnasium_env" in named  # TorchRL's GymEnv reports no success
    assert all(callable(locate(name)) and name.startswith("rrl.") for name in named)


def test_the_new_environment_keeps_its_specs(tmp_path, monkeypatch):
    create("reaching", tmp_path)
    monkeypatch.syspath_prepend(tmp_path / "reaching")
    check_env_specs(import_module("reaching.env").Point())


@pytest.mark.parametrize("name", ["my-project", "1st", "class", "configs", "größe", "Null"])
def test_a_name_that_cannot_be_imported_is_refused(name, tmp_path):
    with pytest.raises(ValueError, match="Python can import"):
        create(name, tmp_path)


@pytest.mark.parametrize("name", ["rrl", "test", "json", "numpy"])
def test_a_name_of_another_package_is_refused(name, tmp_path):
    with pytest.raises(ValueError, match="expected one that no package has"):
        create(name, tmp_path)


def test_nothing_is_overwritten(tmp_path):
    create("mine", tmp_path)
    with pytest.raises(FileExistsError, match="exists already"):
        create("mine", tmp_path)
