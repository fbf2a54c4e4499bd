"""How much room a camera's frames take: ``python -m benchmarks.frames``.

Plays random actions, stores the transitions as a run does, checks that the pictures come back, and prints what all of it takes on
disk beside the bytes of the pictures alone, and how long storing takes.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path

import torch
from torchrl.envs import DMControlWrapper, EnvBase

from rrl.envs import InsertionPixelsEnv  # before dm_control, to find an OpenGL that works
from rrl.trainers.storage.replay_store import ReplayStore, stored_keys

ROUND = 50


def suite_task(domain: str, task: str, side: int) -> EnvBase:
    """Return a task of the dm_control suite with a camera that stands still."""
    from dm_control import suite

    loaded = suite.load(domain, task, task_kwargs={"random": 0})
    size = {"height": side, "width": side, "camera_id": 0}
    return DMControlWrapper(loaded, from_pixels=True, pixels_only=False, render_kwargs=size)


def insertion(side: int) -> EnvBase:
    """Return the insertion task with its camera."""
    return InsertionPixelsEnv(picture_size=side)


TASKS = {
    "insertion-pixels": insertion,
    "reacher": partial(suite_task, "reacher", "easy"),
    "cartpole": partial(suite_task, "cartpole", "swingup"),
    "cheetah (the camera follows it)": partial(suite_task, "cheetah", "run"),
}


def main() -> None:
    """Measure every task."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--transitions", type=int, default=1000)
    parser.add_argument("--side", type=int, default=64, help="pixels of a picture's side")
    arguments = parser.parse_args()
    torch.manual_seed(0)
    for name, make in TASKS.items():
        measure(name, make(side=arguments.side), arguments.transitions)


def measure(name: str, env: EnvBase, transitions: int) -> None:
    """Print what the transitions of an environment take."""
    keys = stored_keys(
        [key for key in env.observation_spec.keys(True, True) if isinstance(key, str)]
    )
    data = env.rollout(transitions, break_when_any_done=False).select(*keys).reshape(-1)
    env.close()
    with tempfile.TemporaryDirectory() as folder:
        store = ReplayStore(Path(folder), transitions, 1)
        start = time.process_time()
        for first in range(0, transitions, ROUND):
            store.extend(data[first : first + ROUND].unsqueeze(0))
        seconds = time.process_time() - start
        on_disk = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
        stored = store.newest()
        assert all(torch.equal(stored[key], data[key]) for key in ("pixels", ("next", "pixels")))
    print(
        f"{name}: pictures {data['pixels'].numel() / 1e6:.1f} MB, all on disk {on_disk / 1e6:.2f} MB, "
        f"storing {1e3 * seconds / transitions:.2f} ms of processor time a transition"
    )


if __name__ == "__main__":
    main()
