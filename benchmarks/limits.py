"""Whether the safety limits hold, under the worst commands that can be thought of.

Plays episodes of full speed into table and blocks, oscillations, random commands, and commands that the cross-entropy
method has optimised for harm, through the limits of ``configs/safety``: each of them alone, and all together. Prints the
largest value that was measured of what each limits, and fails if one is above the limit:

    python benchmarks/limits.py --episodes 10000

``delay`` has all sensors of the limits two control steps late, ``stiff`` and ``soft`` an arm whose stiffness is a fifth
off. Nothing ends an episode before its time.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.envs.utils import step_mdp

from rrl.envs import make_config
from rrl.trainers.cli.compose import compose
from rrl.trainers.configuration import build as assembly
from rrl.transforms import ControlNoise, ObservationLatency

STEPS = 50
"""Control steps of an episode."""
BATCH = 50
"""Episodes side by side: what the cross-entropy method draws at a time."""
POSITION, LATE = "end_effector_position", "late_position"
FORCE, OUTSIDE, SIZE, CHANGE = "force [N]", "outside the box [mm]", "size", "change"
WATCHED = {"force": (FORCE,), "workspace": (OUTSIDE,), "step": (SIZE, CHANGE)}
"""What each of the limits promises; ``all`` promises all of it."""
TOLERANCE = 1e-5
"""Of commands, which are of single precision."""


@dataclass(frozen=True)
class Case:
    """What is wrong with the robot."""

    delay: int = 0
    """Of the sensors that limits read, in control steps."""
    stiffness: float = 1.0
    """Of the arm, as a share of what is known."""


CASES = {
    "nominal": Case(),
    "delay": Case(delay=2),
    "stiff": Case(stiffness=1.2),
    "soft": Case(stiffness=0.8),
    "delay and stiff": Case(delay=2, stiffness=1.2),
}


@dataclass
class Worst:
    """The largest values measured, and in how many episodes."""

    episodes: int = 0
    values: dict[str, float] = field(default_factory=dict)

    def take(self, values: dict[str, Tensor]) -> None:
        """Take in what a batch of episodes came to, ``[B]`` each."""
        self.episodes += len(next(iter(values.values())))
        for name, value in values.items():
            self.values[name] = max(self.values.get(name, -torch.inf), float(value.max()))


def configuration(variant: str, safety: str, case: Case) -> dict[str, Any]:
    """Return what ``rrl train`` would use without a controller."""
    config = compose([f"env=insertion-{variant}", f"safety={safety}", "arm=rl"])
    if config["safety"]["workspace"]:
        config["safety"]["workspace"]["position_key"] = LATE
        config["safety"]["workspace"]["delay"] += case.delay
    return config


def make_env(config: dict[str, Any], case: Case, seed: int) -> EnvBase:
    """Return a batch of environments with nothing but the limits, whose sensors are late."""
    known = make_config(config["env"]["base"]["variant"])
    names = ("joint_stiffness", "cartesian_stiffness")
    changed = {n: tuple(case.stiffness * k for k in getattr(known, n)) for n in names}
    factory = assembly.environment(config)
    # In front of the limits, which stand before everything else.
    late = partial(ObservationLatency, [POSITION], steps=case.delay, out_keys=[LATE])
    watched = partial(ControlNoise, sigma=0.0)  # records what is executed
    factory = replace(factory, sensing=(), disturbances=(watched,), safety=(late, *factory.safety))
    return factory.with_overrides(**changed, seed=seed, num_threads=1).make(BATCH)


def play(env: EnvBase, commands: Tensor, safety: dict[str, Any]) -> dict[str, Tensor]:
    """Play commands ``[B, T, 3]`` and return the largest values, ``[B]`` each."""
    low, high = (torch.tensor(safety["workspace"][side]) for side in ("low", "high"))
    td, last, worst = env.reset(), torch.zeros(len(commands), 3), dict[str, Tensor]()
    for step in range(commands.shape[1]):
        td = step_mdp(env.step(td.set("action", commands[:, step])))
        position, executed = td[POSITION], td["executed_action"]
        now = {
            FORCE: td["metrics", "contact_force"].squeeze(-1),
            OUTSIDE: 1000 * torch.maximum(low - position, position - high).amax(-1),
            SIZE: executed.abs().amax(-1),
            CHANGE: (executed - last).abs().amax(-1),
        }
        worst = {name: torch.maximum(worst.get(name, value), value) for name, value in now.items()}
        last = executed
    return worst


# ------------------------------------------------------------------ commands

Draw = Callable[[torch.Generator], Tensor]
"""From a generator to commands ``[BATCH, STEPS, 3]``."""


def held(low: int, high: int, generator: torch.Generator) -> Tensor:
    """Return random corners of the action's cube, each held for ``low`` to ``high`` steps."""
    corners = torch.randn(BATCH, STEPS, 3, generator=generator).sign()
    lengths = torch.randint(low, high + 1, (BATCH, STEPS), generator=generator).cumsum(1)
    which = torch.searchsorted(
        lengths, torch.arange(STEPS).expand(BATCH, -1).contiguous(), right=True
    )
    return corners.gather(1, which.unsqueeze(-1).expand(-1, -1, 3))


def into_the_table(generator: torch.Generator) -> Tensor:
    """Return full speed ahead for a while, beyond the blocks or not, then down for good."""
    commands = held(STEPS, STEPS, generator)
    away = torch.randint(0, 15, (BATCH, 1), generator=generator)
    down = torch.arange(STEPS) >= away
    commands[..., 2] = torch.where(down, -1.0, torch.zeros(()))
    commands[..., :2] *= (~down).unsqueeze(-1)
    return commands


def into_the_blocks(generator: torch.Generator) -> Tensor:
    """Return down beside a block or into the gap, then full speed sideways, again and again."""
    commands = held(3, 12, generator)
    first = torch.randint(8, 35, (BATCH, 1), generator=generator)
    down = torch.arange(STEPS) < first
    commands[..., 2] = torch.where(down, -1.0, commands[..., 2])
    commands[..., :2] *= torch.where(down, 0.3, torch.ones(())).unsqueeze(-1)
    return commands


def oscillation(generator: torch.Generator) -> Tensor:
    """Return square waves of random periods about a way down, each axis with its own."""
    time = torch.arange(STEPS).reshape(1, -1, 1)
    period = torch.randint(2, 16, (BATCH, 1, 3), generator=generator)
    phase = torch.randint(0, 16, (BATCH, 1, 3), generator=generator)
    wave = 1.0 - 2.0 * ((time + phase) % period >= period / 2)
    wave[..., 2] = torch.where(time[..., 0] < 12, -1.0, wave[..., 2])
    return wave


SCRIPTED: dict[str, Draw] = {
    "into the table": into_the_table,
    "into the blocks": into_the_blocks,
    "oscillation": oscillation,
    "random": partial(held, 1, 1),
    "random, held": partial(held, 2, 10),
}


class CrossEntropy:
    """Commands, held for two steps each, from a normal distribution that moves to the worst.

    Args:
        generator: Draws.
    """

    HOLD, ELITE, KEPT, LEAST = 2, BATCH // 6, 0.2, 0.08

    def __init__(self, generator: torch.Generator) -> None:
        self.generator = generator
        self.mean = torch.zeros(STEPS // self.HOLD, 3)
        self.mean[:, 2] = -1.0  # where there is something to be hit
        self.deviation = torch.full_like(self.mean, 0.7)

    def draw(self) -> Tensor:
        """Return commands ``[BATCH, STEPS, 3]``."""
        noise = torch.randn(BATCH, *self.mean.shape, generator=self.generator)
        self.drawn = self.mean + self.deviation * noise
        return self.drawn.clamp(-1, 1).repeat_interleave(self.HOLD, 1)

    def learn(self, harm: Tensor) -> None:
        """Move to the commands that did most harm, ``[BATCH]``."""
        worst = self.drawn[harm.topk(self.ELITE).indices]
        self.mean = self.KEPT * self.mean + (1 - self.KEPT) * worst.mean(0)
        spread = self.KEPT * self.deviation + (1 - self.KEPT) * worst.std(0)
        self.deviation = spread + self.LEAST


def adversary(
    env: EnvBase, batches: int, harm: str, safety: dict[str, Any], generator: torch.Generator
) -> Iterator[dict[str, Tensor]]:
    """Play ``batches`` of an adversary that starts anew after every twenty."""
    for number in range(batches):
        if number % 20 == 0:
            optimiser = CrossEntropy(generator)
        values = play(env, optimiser.draw(), safety)
        optimiser.learn(values[harm])
        yield values


# ------------------------------------------------------------------ the benchmark


def measure(variant: str, name: str, case: Case, episodes: int, seed: int = 0) -> dict[str, Worst]:
    """Return the worst of every kind of commands under the limit ``name``, or ``all``.

    Half of the episodes are the adversary's.
    """
    config = configuration(variant, name, case)
    promised = compose([f"env=insertion-{variant}", "safety=all", "arm=rl"])["safety"]
    generator = torch.Generator().manual_seed(seed)
    env = make_env(config, case, seed)
    each = max(1, round(episodes / BATCH / 2 / len(SCRIPTED)))
    found = {kind: Worst() for kind in (*SCRIPTED, "adversary")}
    for kind, draw in SCRIPTED.items():
        for _ in range(each):
            found[kind].take(play(env, draw(generator), promised))
    harm = OUTSIDE if name == "workspace" else FORCE
    for values in adversary(env, max(1, round(episodes / BATCH / 2)), harm, promised, generator):
        found["adversary"].take(values)
    env.close()
    return found


def bounds(variant: str) -> dict[str, float]:
    """Return what no value may exceed."""
    safety = compose([f"env=insertion-{variant}", "safety=all", "arm=rl"])["safety"]
    return {
        FORCE: safety["force"]["limit"],
        OUTSIDE: 0.0,
        SIZE: safety["step"]["size"] + TOLERANCE,
        CHANGE: safety["step"]["change"] + TOLERANCE,
    }


def excesses(variant: str, name: str, found: dict[str, Worst]) -> list[str]:
    """Return what is above a limit that ``name`` promises, in words."""
    promised = (
        [v for values in WATCHED.values() for v in values] if name == "all" else WATCHED[name]
    )
    limits = bounds(variant)
    return [
        f"{variant}, {name}, {kind}: {value} {worst.values[value]:.4g} > {limits[value]:.4g}"
        for kind, worst in found.items()
        for value in promised
        if worst.values[value] > limits[value]
    ]


def main() -> None:
    """Measure, print, and fail if a limit did not hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--episodes", type=int, default=10000, help="of each variant and case, over all limits"
    )
    parser.add_argument("--variants", nargs="+", default=["sim", "real"])
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--limits", nargs="+", default=[*WATCHED, "all"], choices=[*WATCHED, "all"])
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    columns = (FORCE, OUTSIDE, SIZE, CHANGE)
    print("| variant | case | limits | commands | episodes | " + " | ".join(columns) + " |")
    print("|---" * (5 + len(columns)) + "|")
    failures = []
    for variant in options.variants:
        for case in options.cases:
            for name in options.limits:
                share = options.episodes // len(options.limits)
                found = measure(variant, name, CASES[case], share, options.seed)
                failures += [f"{case}: {text}" for text in excesses(variant, name, found)]
                for kind, worst in found.items():
                    cells = " | ".join(f"{worst.values[c]:.2f}" for c in columns)
                    print(
                        f"| {variant} | {case} | {name} | {kind} | {worst.episodes} | {cells} |",
                        flush=True,
                    )
    print("\n".join(failures) or "No limit was exceeded.")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
