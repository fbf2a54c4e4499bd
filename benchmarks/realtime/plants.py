"""Plants and the training on them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]


@contextmanager
def plant(address: str, rate: int) -> Iterator[None]:
    """A plant of ``rate`` control steps a second, whose arm is as quick at every rate."""
    substeps = round(500 / rate)
    overrides = [f"substeps={substeps}", f"action_scale={0.02 * substeps / 25}"]
    command = [sys.executable, "-m", "rrl.envs.plant", "--address", address, *overrides]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        if "listens" not in process.stdout.readline():
            raise SystemExit("the plant did not start")
        yield
    finally:
        process.terminate()
        process.wait()
        process.stdout.close()


def training(run_dir: Path, address: str, rate: int, steps: int) -> list[str]:
    """The arguments of ``rrl train`` on the plant."""
    episode = round(2.5 * rate)
    return [
        "env=robot/plant",
        f"env.base.robot.address={address}",
        f"env.base.episode_steps={episode}",
        f"env.max_episode_steps={episode}",
        "trainer.collection=realtime",
        f"trainer.total_steps={steps}",
        "trainer.warmup_steps=200",
        "trainer.evaluation.every=0",
        "trainer.evaluation.final_episodes=1",
        "trainer.acceptance.enabled=false",
        f"trainer.checkpoint.every={2 * rate // 50 * 50 or 50}",
        "algorithm.agent.compiled=false",
        "render.enabled=false",
        "logger=[csv]",
        f"hydra.run.dir={run_dir}",
    ]
