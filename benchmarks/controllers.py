"""How hand-written controllers fare on the block insertion: the calibration of the task.

Prints a table of success rates with Wilson 95 % intervals for the paper's proportional controller
and for a scripted press-and-drag, which shows that a solution exists where the controller fails:

    python benchmarks/controllers.py --episodes 200 --threads 2
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from rrl.controllers import ProportionalController
from rrl.envs import InsertionEnv

UNIT = 0.02
"""Metres that an action of 1 stands for."""
POLICIES = ("hand controller", "press and drag")
STRAIGHT: dict[str, Any] = {"yaw_choices": (0.0,)}
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
    """Mean and standard deviation of the noise on the control output, normalised."""


def rows() -> list[Row]:
    """Return the settings of the paper, and press-and-drag where blocks are misaligned."""
    hand, drag = POLICIES
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
        Row("sim", "yaw U[-0.3, 0.3], sigma 0.1", drag, "", {"yaw_range": 0.3}, exploration),
        Row("real", "yaw {-20, 0, 20} deg, sigma 0.1", drag, "", {}, exploration),
    ]


Policy = Callable[[TensorDictBase, int], Tensor]
"""From the observation and the step within the episode to the action [B, 3]."""


def hand_controller() -> Policy:
    """Return the paper's pi_H: u = clip(K (x_g - x), +-0.5) with K = 25 / m."""
    controller = ProportionalController(gain=0.5, clip=0.5, unit=UNIT)
    return lambda observation, step: controller.act(observation)


@dataclasses.dataclass(frozen=True)
class PressAndDrag:
    """A fixed sequence: press on one standing block at a time, drag it outwards, then insert.

    Friction between held block and standing block is larger than below the standing block, so it
    follows. Lengths in metres.
    """

    press: float
    """Action along z while dragging, 0 to 1 downwards."""
    reach: float = 0.02
    """Distance from the goal, along x, where the tool comes down."""
    drag: float = 0.018
    """Length of the drag."""
    rest: float = 0.08
    """Height of the tool above its goal when the held block rests on the standing blocks."""
    clearance: float = 0.01
    durations: tuple[int, int, int, int, int] = (7, 6, 6, 6, 6)
    """Steps: approach, drag right, cross over, drag left, return; then the insertion."""

    def __call__(self, observation: TensorDictBase, step: int) -> Tensor:
        """Return the action [B, 3]."""
        error = observation["goal"] - observation["end_effector_position"]
        x, z = self._target(step)
        action = error / UNIT
        action[:, 0] = ((error[:, 0] + x) / UNIT).clamp(-0.8, 0.8)
        action[:, 1] = (0.4 * action[:, 1]).clamp(-0.5, 0.5)
        action[:, 2] = -self.press if z is None else (error[:, 2] + z) / UNIT
        return action.clamp(-1, 1)

    def _target(self, step: int) -> tuple[float, float | None]:
        """Return the position relative to the goal (x, z); z ``None`` means press."""
        ends = [sum(self.durations[: i + 1]) for i in range(5)]
        far, above = self.reach + self.drag, self.rest + self.clearance
        if step < ends[0]:
            return self.reach, self.rest + self.clearance / 2
        if step < ends[1]:
            return far, None
        if step < ends[2]:
            return (far if step < ends[1] + 2 else -self.reach), above  # up first, then across
        if step < ends[3]:
            return -far, None
        if step < ends[4]:
            return (-far if step < ends[3] + 2 else 0.0), above
        return 0.0, 0.0


def make_policy(row: Row) -> Policy:
    """Return the policy of a row; the compliant variant presses harder and lags behind."""
    if row.policy == "hand controller":
        return hand_controller()
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
        for step in range(env.config.episode_length):
            action = policy(observation, step)
            noise = torch.randn(action.shape, generator=generator) * deviation + mean
            action = (action + noise).clamp(-1, 1)
            observation = env.step(TensorDict({"action": action}, env.batch_size))["next"]
        successes += int(observation["success"].sum())
    env.close()
    return successes, batches * num_envs


def wilson(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a rate."""
    rate = successes / trials
    center = rate + z * z / (2 * trials)
    spread = z * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials**2))
    scale = 1 + z * z / trials
    return max(0.0, (center - spread) / scale), min(1.0, (center + spread) / scale)


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
