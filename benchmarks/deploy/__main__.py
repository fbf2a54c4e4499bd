"""An exported policy beside the trainer's own chain.

    python -m benchmarks.deploy                    # the default networks with random weights, safety=all
    python -m benchmarks.deploy --run outputs/NAME/TIME --episodes 100

Latency and missed deadlines of a loop at fixed rates; memory and time up to the first command of a fresh process; the
exported policy on the run's frozen final episodes: solved by it and by the trainer's chain, and the largest difference
of two commands for the same observation. Nothing else should run meanwhile: what is measured is this machine.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from rrl.deploy import Policy
from rrl.deploy.archive import torch_graph
from rrl.deploy.contract import ARCHIVE, MODEL, read_contract
from rrl.trainers.cli.compose import compose
from rrl.trainers.configuration import build as assembly
from rrl.trainers.environment import EnvironmentFactory
from rrl.trainers.export.folder import export_policy
from rrl.trainers.export.specs_only import SpecsOnly, chain_on
from rrl.trainers.pretrained import best_run, trained_run
from rrl.trainers.seeds import Stream, first_seed

from .episodes import exported_episode, trainers_episode
from .pace import keep_pace

SHOWN = 64
"""Observations that the loops go through."""
TRAINER = "trainer's chain"

FIRST_COMMAND = """
import sys
import numpy as np
from rrl.deploy import Policy
from rrl.deploy.contract import read_contract
graph = None
if sys.argv[2] == "policy.pt2":
    from rrl.deploy.archive import torch_graph
    graph = torch_graph(sys.argv[1])
policy = Policy(sys.argv[1], read_contract(sys.argv[1]).rate, graph)
policy.act({e.name: np.zeros(e.shape, e.dtype) for e in policy.contract.entries})
print(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1])
"""
FIRST_ACTION = """
import sys, yaml
from rrl.trainers.configuration import build
config = yaml.safe_load(open(sys.argv[1]))
factory = build.environment(config)
env = factory.make(1)
agent = build.agent(config)(inputs=factory.read_inputs(env), action_size=env.action_spec.shape[-1])
env.step(agent.policy(env.reset()))
print(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1])
"""


def main() -> None:
    """Measure, and print tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--run", type=Path, help="a run's directory")
    parser.add_argument("--rates", type=float, nargs="+", default=[100.0, 500.0, 1000.0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of each loop")
    parser.add_argument("--episodes", type=int, default=10, help="frozen episodes")
    options = parser.parse_args()
    torch.set_num_threads(1)
    config, policy = of_run(options.run) if options.run else with_random_weights()
    environment = assembly.environment(config)
    with tempfile.TemporaryDirectory() as scratch:
        folder, file = Path(scratch, "export"), Path(scratch, "config.yaml")
        export_policy(environment, policy, folder)
        file.write_text(yaml.safe_dump(config))
        loops(environment, policy, folder, options.rates, options.seconds)
        starts(folder, file)
        frozen_episodes(config, policy, folder, options.episodes)


def of_run(run: Path) -> tuple[Any, Any]:
    """Return a run's configuration, and the policy that it hands over."""
    path = best_run(run)
    config = yaml.safe_load((path / "config.yaml").read_text())
    return config, trained_run(config, path).handed_over.policy


def with_random_weights() -> tuple[Any, Any]:
    """Return the default configuration with all safety limits, and a policy that nobody has trained."""
    config = compose(["safety=all", "algorithm.agent.compiled=false"])
    environment = assembly.environment(config)
    env = environment.make(1)
    torch.manual_seed(0)
    policy = assembly.agent(config)(
        inputs=environment.read_inputs(env), action_size=env.action_spec.shape[-1]
    ).policy
    env.close()
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(0.01 * torch.randn_like(parameter))
    return config, policy


def loops(
    environment: EnvironmentFactory, policy: Any, folder: Path, rates: list[float], seconds: float
) -> None:
    """Print what a step takes in loops at fixed rates."""
    exported, archive = both(folder)
    generator = np.random.default_rng(0)
    shown = [
        {e.name: generator.normal(size=e.shape).astype(e.dtype) for e in exported.contract.entries}
        for _ in range(SHOWN)
    ]
    steps: dict[str, Callable[[int], object]] = {
        TRAINER: trainers_step(environment, policy, shown),
        ARCHIVE: lambda number: archive.act(shown[number % SHOWN]),
        MODEL: lambda number: exported.act(shown[number % SHOWN]),
    }
    rows = []
    for rate in rates:
        for name, step in steps.items():
            keep_pace(step, rate, 1.0)  # what is made at first use is made
            rows.append([f"{rate:g} Hz", name, *keep_pace(step, rate, seconds).row()])
    table(["rate", "who", "p50 [us]", "p99 [us]", "max [us]", "missed deadlines"], rows)


def trainers_step(
    environment: EnvironmentFactory, policy: Any, shown: list[dict[str, np.ndarray]]
) -> Callable[[int], object]:
    """Return a step of the trainer's chain, on an environment that takes no time itself."""
    env = environment.make(1)
    robot = SpecsOnly(env.base_env)
    env.close()
    keys, observations = robot.entry_keys(), []
    for entries in shown:
        td = robot.blank()
        for name, value in entries.items():
            td.set(keys[name], torch.from_numpy(value).reshape(td.get(keys[name]).shape))
        observations.append(td)
    robot.shown = observations[0]
    chain = chain_on(robot, environment)
    seen = chain.reset()

    def step(number: int) -> None:
        nonlocal seen
        robot.shown = observations[number % SHOWN]
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            seen = step_mdp(chain.step(policy(seen)))

    return step


def starts(folder: Path, config: Path) -> None:
    """Print memory of, and time up to the first command of, a fresh process."""
    programs = {
        TRAINER: [FIRST_ACTION, str(config)],
        ARCHIVE: [FIRST_COMMAND, str(folder), ARCHIVE],
        MODEL: [FIRST_COMMAND, str(folder), MODEL],
    }
    rows = []
    for name, program in programs.items():
        began = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", *program], check=True, stdout=subprocess.PIPE
        )
        took = time.perf_counter() - began
        rows.append([name, f"{took:.2f}", f"{int(done.stdout) / 1024:.0f}"])
    table(["who", "first command after [s]", "memory [MiB]"], rows)


def frozen_episodes(config: Any, policy: Any, folder: Path, episodes: int) -> None:
    """Print how the same final episodes end, and how far commands for the same entries differ.

    Without disturbances: in the trainer they come before the safety limits, on a robot after them.
    """
    environment = replace(next(iter(assembly.scenarios(config).values())), disturbances=())
    first = first_seed(Stream.FINAL, assembly.settings(config).evaluation.seed)
    rows = []
    for name, exported in zip((MODEL, ARCHIVE), both(folder), strict=True):
        trainers = [
            trainers_episode(environment, policy, exported, first + i) for i in range(episodes)
        ]
        alone = [exported_episode(environment, exported, first + i) for i in range(episodes)]
        solved = [[e.solved for e in group] for group in (trainers, alone)]
        difference = max(np.abs(e.shadow - e.commands).max() for e in trainers)
        apart = max(
            np.abs(e.commands - other.commands).max()
            for e, other in zip(trainers, alone, strict=True)
            if len(e.commands) == len(other.commands)
        )
        rows.append(
            [
                name,
                *(f"{sum(flags)} of {episodes}" for flags in solved),
                str(sum(a == b for a, b in zip(*solved, strict=True))),
                f"{difference:.1e}",
                f"{apart:.1e}",
            ]
        )
    columns = ["who", "solved by the trainer's chain", "by itself", "episodes that end alike"]
    table([*columns, "difference on the same entries", "on its own way"], rows)


def both(folder: Path) -> tuple[Policy, Policy]:
    """Return what onnxruntime and torch run."""
    rate = read_contract(folder).rate
    return Policy(folder, rate), Policy(folder, rate, graph=torch_graph(folder))


def table(columns: list[str], rows: list[list[str]]) -> None:
    """Print a Markdown table."""
    for row in [columns, ["---"] * len(columns), *rows]:
        print(f"| {' | '.join(row)} |")
    print(flush=True)


if __name__ == "__main__":
    main()
