"""docs/robot.md from the first line to the last: a driver, a plant, training, export, deployment."""

import json
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from plants import an_address, plant
from rrl.trainers.cli.main import main
from rrl.trainers.cli.new import create

PAGE = (Path(__file__).parents[1] / "docs/robot.md").read_text()
SHORT = [
    "trainer.total_steps=200",
    "trainer.warmup_steps=100",
    "trainer.evaluation.final_episodes=1",
    "trainer.acceptance.enabled=false",
    "trainer.checkpoint.every=0",
    "algorithm.agent.compiled=false",
    "render.enabled=false",
    "logger=csv",
]
ADDRESS, RUN = "ipc:///tmp/rrl-plant", "outputs/NAME/TIME"
RAIL = "ipc:///tmp/rail"


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_driver_makes_an_environment(capsys):
    exec(compile(blocks("python")[0], "driver", "exec"), {"__name__": "driver"})
    assert "tensor([" in capsys.readouterr().out


@pytest.mark.slow
def test_a_robot_of_ones_own_is_trained_in_a_project(tmp_path):
    create("my_project", tmp_path)
    project, address = tmp_path / "my_project", an_address()
    driver, served, _ = blocks("python")
    (project / "my_project/rail.py").write_text(driver.partition("\nenv = ")[0])
    for text in (served, *blocks("yaml")):
        (project / text.split()[1]).write_text(text.replace(RAIL, address))
    serve = [sys.executable, "-m", "my_project.serve_rail"]
    rail = [
        "env=rail",
        "controller=rail",
        "trainer.collection=realtime",
        "+env.base.robot.patience=5.0",
        "trainer.evaluation.every=0",
    ]
    train = [sys.executable, "-m", "rrl.trainers", "train", *rail, "hydra.run.dir=run", *SHORT]
    with subprocess.Popen(serve, cwd=project) as server:
        try:
            trained = subprocess.run(
                train, cwd=project, capture_output=True, text=True, timeout=250
            )
        finally:
            server.send_signal(signal.SIGTERM)
    assert trained.returncode == 0, trained.stdout + trained.stderr
    assert server.returncode == 128 + signal.SIGTERM
    (record,) = json.loads((project / "run/results.json").read_text()).values()
    assert record["episodes"]["controller_success"] == [0.0]  # the slope leaves it 8 mm off


@pytest.mark.slow
def test_the_way_from_the_plant_to_the_robot(tmp_path, capsys):
    address, run = an_address(), tmp_path / "run"
    start, train, export = (shlex.split(block) for block in blocks("sh"))
    with plant(address, *start[3:]):
        where = [f"env.base.robot.address={address}", f"hydra.run.dir={run}"]
        assert main([*train[1:], *where, *SHORT]) == 0
        assert main([argument.replace(RUN, str(run)) for argument in export[1:]]) == 0
        drive = blocks("python")[2].replace(RUN, str(run))
        drive = drive.replace(f'"{ADDRESS}"', f'"{address}", patience=5.0')  # on a busy machine
        assert address in drive
        capsys.readouterr()
        exec(compile(drive, "drive", "exec"), {})
    assert "solved" in capsys.readouterr().out
