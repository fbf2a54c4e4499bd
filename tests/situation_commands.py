"""``rrl`` as a process, with a run that takes seconds."""

import os
import subprocess
import sys
import time
from pathlib import Path

SMALL = [
    "env=insertion-sim",
    "algorithm=td3",
    "algorithm.agent.network.hidden=[8]",
    "algorithm.agent.compiled=false",
    "trainer.total_steps=100",
    "trainer.warmup_steps=50",
    "trainer.batch_size=16",
    "trainer.evaluation.every=0",
    "trainer.evaluation.episodes=2",
    "trainer.evaluation.final_episodes=2",
    "trainer.evaluation.slots=2",
    "trainer.acceptance.enabled=false",
    "trainer.checkpoint.every=50",
    "render.enabled=false",
    "render.episode=0",
    "render.width=64",
    "render.height=48",
    "logger=csv",
]
LONG = [*SMALL, "trainer.total_steps=100000"]
RRL = [sys.executable, "-m", "rrl.trainers"]
BIN = str(Path(sys.executable).parent)


def environment(**variables):
    """As the shell of somebody who has just activated the virtual environment."""
    path = os.pathsep.join([BIN, os.environ["PATH"]])
    return {**os.environ, "PATH": path, "OMP_NUM_THREADS": "1", **variables}


def shell(script, cwd, **variables):
    """Run lines of bash; returns the finished process, with output as bytes."""
    command = ["bash", "-c", script]
    return subprocess.run(
        command, cwd=cwd, env=environment(**variables), capture_output=True, timeout=280
    )


def start(*arguments, cwd, **options):
    """Start a command."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
    variables = options.pop("variables", {})
    return subprocess.Popen(
        [*RRL, *arguments], cwd=cwd, env=environment(**variables), **{**pipes, **options}
    )


def wait_for_training(folder, process):
    """Wait until a run below a folder has logged a round of training; returns its directory."""
    while process.poll() is None:
        # Not by rglob, which minds that a folder on its way, as of a checkpoint, goes away meanwhile.
        for name, _, files in os.walk(folder):
            path = Path(name) / "metrics.csv"
            if path.name in files and "train/reward" in path.read_text():
                return path.parent
        time.sleep(0.1)
    raise AssertionError((process.communicate(), list(Path(folder).rglob("*"))))


def checkpoints(run_dir):
    """Environment steps of a run's checkpoints."""
    found = sorted(run_dir.glob("checkpoints/checkpoint-*"))
    return [int(path.name.removeprefix("checkpoint-")) for path in found]
