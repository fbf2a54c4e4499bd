"""How hand-written controllers fare on the block insertion: the calibration of the task.

Prints a table of success rates with Wilson 95 % intervals for the paper's proportional controller
and for a scripted press-and-drag, which shows that a solution exists where the controller fails:

    python benchmarks/controllers.py --episodes 200 --threads 2
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from typing import Any

import torch
from tensordict import TensorDict

from rrl.controllers import Controller, ProportionalController
from rrl.envs import InsertionEnv, PressAndDrag
from rrl.trainers.evaluation.statistics import wilson

UNIT = 0.02
"""Metres that an action of 1 stands for."""
POLICIES = ("hand controller", "press and drag", "press and drag, sees the gap")
STRAIGHT: dict[str, Any] = {"yaw_choices": (0.0,)}
ELSEWHERE: dict[str, Any] = {"place_range": (0.0, 0.03)}
"""As in env=insertion-pixels."""
Noise = tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Row:
    """One line of the table."""

    variant: str
    setting: str
    policy: str
    wanted: str
    """The rate that the project promises."""
    overrides: dict[str, Any] = dataclasses.field(default_factory=dict)
    noise: Noise = (0.0, 0.0)
    """Mean and standard deviation of the noise on the control output, normalized."""


def rows() -> list[Row]:
    """Return the settings of the paper, and press-and-drag where blocks are misaligned."""
    hand, drag, seeing = POLICIES
    wanted = {0.0: ">= 98 %", 0.3: "<= 60 %"}
    uniform = [
        Row("sim", f"yaw U[-{r}, {r}]", hand, wanted.get(r, "falling"), {"yaw_range": r})
        for r in (0.0, 0.1, 0.2, 0.3)
    ]
    bias = (0.2, 0.05)
    exploration = (0.0, 0.1)
    return [
        *uniform,
        Row("sim", "aligned, bias 0.2, sigma 0.05", hand, "<= 30 %", STRAIGHT, bias),
        Row("real", "aligned", hand, ">= 95 %", STRAIGHT),
        Row("real", "yaw {-20, 0, 20} deg", hand, "<= 15 %"),
        Row("real", "aligned, bias 0.2, sigma 0.05", hand, "<= 30 %", STRAIGHT, bias),
        Row("sim", "yaw U[-0.3, 0.3]", drag, ">= 90 %", {"yaw_range": 0.3}),
        Row("real", "yaw {-20, 0, 20} deg", drag, ">= 90 %"),
        Row("real", "the same, elsewhere along the gap", hand, "<= 15 %", ELSEWHERE),
        Row("real", "the same, elsewhere along the gap", drag, "<= 45 %", ELSEWHERE),
        Row("real", "the same, elsewhere along the gap", seeing, ">= 90 %", ELSEWHERE),
        Row("sim", "yaw U[-0.3, 0.3], sigma 0.1", drag, "", {"yaw_range": 0.3}, exploration),
        Row("real", "yaw {-20, 0, 20} deg, sigma 0.1", drag, "", {}, exploration),
    ]


def make_policy(row: Row) -> Controller:
    """Return the paper's pi_H, u = clip(K (x_g - x), +-0.5) with K = 25 / m, or the script.

    Where the arm is compliant, the script presses harder and drags further.
    """
    if row.policy == "hand controller":
        return ProportionalController(gain=0.5, clip=0.5, unit=UNIT)
    return PressAndDrag(press=0.5) if row.variant == "sim" else PressAndDrag(press=1.0, drag=0.03)


def run(row: Row, episodes: int, num_envs: int, threads: int, seed: int) -> tuple[int, int]:
    """Return successes and episodes, the latter rounded up to whole batches."""
    env = InsertionEnv(
        row.variant, num_envs=num_envs, num_threads=threads, seed=seed, **row.overrides
    )
    generator = torch.Generator().manual_seed(seed)
    policy = make_policy(row)
    mean, deviation = row.noise
    successes = 0
    batches = math.ceil(episodes / num_envs)
    for _ in range(batches):
        observation = env.reset()
        policy.reset()
        for _ in range(env.config.episode_length):
            if row.policy == POLICIES[2]:  # the goal is the middle of the blocks along the gap
                observation["goal"][:, 1] = observation["blocks"][:, [1, 6]].mean(-1)
            action = policy.act(observation)
            noise = torch.randn(action.shape, generator=generator) * deviation + mean
            action = (action + noise).clamp(-1, 1)
            observation = env.step(TensorDict({"action": action}, env.batch_size))["next"]
        successes += int(observation["success"].sum())
    env.close()
    return successes, batches * num_envs


def main() -> None:
    """Run every row and print it as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=200, help="episodes of each row")
    parser.add_argument("--num-envs", type=int, default=50, help="environments of a batch")
    parser.add_argument("--threads", type=int, default=1, help="threads for physics")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print("| variant | setting | policy | success | 95 % interval | episodes | wanted |")
    print("|---|---|---|---|---|---|---|")
    for row in rows():
        hits, trials = run(row, options.episodes, options.num_envs, options.threads, options.seed)
        low, high = wilson(hits, trials)
        print(
            f"| {row.variant} | {row.setting} | {row.policy} | {100 * hits / trials:.1f} % "
            f"| {100 * low:.1f}-{100 * high:.1f} % | {trials} | {row.wanted} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
