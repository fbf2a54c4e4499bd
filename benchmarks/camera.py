"""What a camera costs: milliseconds a frame, and its share of a control step.

Prints a table for each batch size: a control step without and with a camera, what one frame takes,
and a control step whose pictures are drawn by a thread, half of the slots at a time, while the
other half's physics run:

    python -m benchmarks.camera --slots 1 8 --steps 150
    python -m benchmarks.camera --strip docs/figures/camera.png # what the policy sees
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import imageio.v3 as iio
import numpy as np
import torch
from tensordict import TensorDict

from rrl.controllers import ProportionalController
from rrl.envs import InsertionEnv, InsertionPixelsEnv
from rrl.envs.opengl import find_backend

HEADER = ("slots", "no camera", "with camera", "a frame", "share of the step", "drawn in a thread")
MOMENTS = (0, 3, 6, 9, 12, 25)
"""Control steps of the pictures of a strip."""
Step = Callable[[], object]


def stepping(env: InsertionEnv) -> Step:
    """Return a function that takes one control step, and resets at the end of the episodes."""
    env.reset()
    action = torch.zeros(env.num_envs, 3)
    action[:, 2] = -0.5

    def step() -> None:
        done = env.step(TensorDict({"action": action}, env.batch_size))["next", "done"]
        if done.any():
            env.reset()

    return step


def overlapped(env: InsertionPixelsEnv, thread: ThreadPoolExecutor) -> Step | None:
    """Return a step of two halves: one half's physics run while the other half is drawn.

    The drawing thread owns the OpenGL context. None: there are no two halves.
    """
    if env.num_envs < 2:
        return None
    halves = [InsertionEnv("real", num_envs=env.num_envs // 2, num_threads=1) for _ in range(2)]
    steps = [stepping(half) for half in halves]
    camera = env.camera

    def draw(half: InsertionEnv) -> None:
        still = np.zeros(2)
        for state in half.physics_state():
            camera.draw(state, still, still)

    def step() -> None:
        drawn = []
        for half, advance in zip(halves, steps, strict=True):
            advance()
            drawn.append(thread.submit(draw, half))
        for picture in drawn:
            picture.result()

    return step


def milliseconds(steps: list[Step], count: int) -> list[float]:
    """Return the median time of each step; they take turns, so that all meet the same machine."""
    taken: list[list[float]] = [[] for _ in steps]
    for number in range(count + 10):
        for step, times in zip(steps, taken, strict=True):
            began = time.perf_counter()
            step()
            if number >= 10:
                times.append(time.perf_counter() - began)
    return [1e3 * float(np.median(times)) for times in taken]


def row(slots: int, size: int, steps: int) -> list[str]:
    """Measure one batch size."""
    blind = InsertionEnv("real", num_envs=slots, num_threads=1)
    seeing = InsertionPixelsEnv(num_envs=slots, num_threads=1, picture_size=size)
    other = InsertionPixelsEnv(num_envs=slots, num_threads=1, picture_size=size)
    with ThreadPoolExecutor(1) as thread:
        both = overlapped(other, thread)
        times = milliseconds([stepping(blind), stepping(seeing), *([both] if both else [])], steps)
        thread.submit(other.close).result()
    seeing.close()
    alone, together = times[:2]
    frame = (together - alone) / slots
    cells = [f"{alone:.2f} ms", f"{together:.2f} ms", f"{frame:.2f} ms"]
    cells += [f"{1 - alone / together:.0%}", f"{times[2]:.2f} ms" if both else "no two halves"]
    return [str(slots), *cells]


def strip(out: str, size: int) -> None:
    """Draw one episode of the controller: as it is, with the lamp moved, and the camera shifted."""
    controller = ProportionalController(gain=0.5, clip=0.5, unit=0.02)
    disturbances = [{}, {"light_shift": (1.0, 1.0, 0.0)}, {"camera_shift": (0.02, 0.0, 0.0)}]
    rows = []
    for disturbance in disturbances:
        env = InsertionPixelsEnv(seed=3, picture_size=size, place_range=(0.0, 0.03), **disturbance)
        observation, seen = env.reset(), []
        for step in range(env.config.episode_length):
            if step in MOMENTS:
                seen.append(observation["pixels"][0].numpy())
            action = controller.act(observation)
            observation = env.step(TensorDict({"action": action}, env.batch_size))["next"]
        rows.append(np.concatenate(seen, axis=1))
        env.close()
    picture = np.concatenate(rows, axis=0)
    iio.imwrite(out, picture.repeat(3, axis=0).repeat(3, axis=1))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--slots", type=int, nargs="+", default=[1, 8], help="batch sizes")
    parser.add_argument("--size", type=int, default=64, help="pixels")
    parser.add_argument("--steps", type=int, default=150, help="control steps of each")
    parser.add_argument("--strip", help="a PNG to draw instead")
    options = parser.parse_args()
    if options.strip:
        strip(options.strip, options.size)
        return
    torch.set_num_threads(1)
    print(f"{find_backend()}, {options.size} x {options.size} pixels, median of {options.steps}\n")
    print(f"| {' | '.join(HEADER)} |\n|{'---|' * len(HEADER)}")
    for slots in options.slots:
        print(f"| {' | '.join(row(slots, options.size, options.steps))} |", flush=True)


if __name__ == "__main__":
    main()
