"""docs/robot.md from the first line to the last: a driver, a plant, training, export, deployment."""

import re
import shlex
from pathlib import Path

import pytest

from plants import an_address, plant
from rrl.trainers.cli.main import main

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


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_driver_makes_an_environment(capsys):
    exec(compile(blocks("python")[0], "driver", "exec"), {"__name__": "driver"})
    assert "tensor([" in capsys.readouterr().out


@pytest.mark.slow
def test_the_way_from_the_plant_to_the_robot(tmp_path, capsys):
    address, run = an_address(), tmp_path / "run"
    start, train, export = (shlex.split(block) for block in blocks("sh"))
    with plant(address, *start[3:]):
        where = [f"env.base.robot.address={address}", f"hydra.run.dir={run}"]
        assert main([*train[1:], *where, *SHORT]) == 0
        assert main([argument.replace(RUN, str(run)) for argument in export[1:]]) == 0
        drive = blocks("python")[1].replace(RUN, str(run))
        drive = drive.replace(f'"{ADDRESS}"', f'"{address}", patience=5.0')  # on a busy machine
        assert address in drive
        capsys.readouterr()
        exec(compile(drive, "drive", "exec"), {})
    assert "solved" in capsys.readouterr().out
