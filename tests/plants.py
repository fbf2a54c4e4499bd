"""Plants in processes of their own, for the tests that drive one."""

from __future__ import annotations

import subprocess
import sys
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from rrl.controllers import ProportionalController
from rrl.envs import RobotEnv
from rrl.envs.plant import RemoteRobot
from rrl.trainers.environment import EnvironmentFactory, Input

FAST = ("substeps=5", "action_scale=0.004")
"""100 Hz."""


def an_address() -> str:
    """An address of no other plant, in Linux's own name space: a file's path may be too long."""
    return f"ipc://@plant-{uuid.uuid4().hex}"


@contextmanager
def plant(address: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A plant that listens at ``address`` while the body runs."""
    command = [sys.executable, "-m", "rrl.envs.plant", "--address", address, *arguments]
    process = subprocess.Popen(command, cwd=Path(__file__).parents[1], stdout=subprocess.PIPE)
    try:
        assert process.stdout is not None
        assert b"listens" in process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def plant_factory(address: str, episode_steps: int = 20, **arguments: object) -> EnvironmentFactory:
    """The insertion task on the plant at ``address``, under its P-controller."""
    robot = partial(RemoteRobot, address, **arguments)
    return EnvironmentFactory(
        base=partial(RobotEnv, robot, episode_steps=episode_steps),
        controller=partial(ProportionalController, gain=1.0, clip=0.5, unit=0.02),
        inputs={"end_effector_position": Input(), "goal": Input()},
        residual_scale=0.5,
        batching="serial",
        max_episode_steps=episode_steps,
    )
