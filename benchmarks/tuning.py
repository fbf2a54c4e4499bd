"""Tune the hand controller instead of learning on top of it, with as many episodes of the robot.

    python -W ignore -m benchmarks.tuning            # 60 and 200 episodes, ten seeds; pip install -e '.[benchmark]' in the clone

Gains, bounds and a shift of the goal, each for x, y and z, by CMA-ES and by Bayesian optimization with a Gaussian process
(Optuna's). Three quarters of the episodes go into the search, each candidate plays ``EACH``; the rest into the best few
of them, of which the best by the mean of all its episodes is taken. What counts is the return, as for a learner, or
success, and the return where that is equal. The table has 100 final episodes that nothing was chosen on, the same as those
of `rrl train env=insertion-real`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product

import numpy as np
import optuna
import torch
from hydra.utils import instantiate
from numpy.typing import NDArray
from optuna.samplers import BaseSampler, CmaEsSampler, GPSampler
from torch import Tensor

from rrl.controllers import ProportionalController
from rrl.trainers.cli.compose import compose
from rrl.trainers.evaluation.episodes import Episodes
from rrl.trainers.evaluation.rollout import run_episodes
from rrl.trainers.evaluation.statistics import rate_interval
from rrl.trainers.seeds import Stream, first_seed

Parameters = dict[str, float]
Values = NDArray[np.floating]

EACH, FINALISTS, SEARCH = 4, 5, 0.75
FINAL = 100
AXES = "xyz"
RANGES = {"gain": (0.1, 3.0, True), "clip": (0.1, 1.0, True), "shift": (-0.03, 0.03, False)}
"""Least, largest, whether on a logarithmic scale; shares of the error, of the action, m."""
UNTUNED = {"gain": 0.5, "clip": 0.5, "shift": 0.0}
KNOWN = {f"{name}_{axis}": value for name, value in UNTUNED.items() for axis in AXES}
"""The controller as it is, where both methods begin."""
METHODS: dict[str, Callable[[int], BaseSampler]] = {
    "CMA-ES": lambda seed: CmaEsSampler(x0=dict(KNOWN), sigma0=0.2, seed=seed),
    "Bayesian optimization": lambda seed: GPSampler(seed=seed, n_startup_trials=10),
}
GOALS: dict[str, Callable[[Episodes], Values]] = {
    "return": lambda found: found.returns,
    "success": lambda found: _success(found) + 0.01 * found.returns,
}


class ShiftedController(ProportionalController):
    """The hand controller, to a place beside the goal."""

    def __init__(self, shift: Sequence[float], **arguments: object) -> None:
        super().__init__(**arguments)  # type: ignore[arg-type]
        self.register_buffer("_shift", torch.tensor(shift))

    def error(self, tensordict: object) -> Tensor:
        """Return the error with respect to that place."""
        return super().error(tensordict) + self._shift  # type: ignore[arg-type]


def controller(parameters: Parameters) -> ShiftedController:
    """Build the controller of a candidate."""
    named = {name: [parameters[f"{name}_{axis}"] for axis in AXES] for name in RANGES}
    return ShiftedController(**named, unit=0.02, out_key="action")


class Robot:
    """Plays episodes, each one a new one."""

    def __init__(self, scenario: str, goal: str, seed: int) -> None:
        config = compose(["env=insertion-real"])["env"]
        self._make = partial(instantiate, config["base"] | config["scenarios"][scenario])
        self._env, self._steps = self._make(num_envs=EACH), config["max_episode_steps"]
        self._goal, self._seed, self.played = GOALS[goal], first_seed(Stream.TRAINING, seed), 0

    def values(self, parameters: Parameters, episodes: int) -> list[float]:
        """Play the next episodes of the training."""
        at = self._seed + self.played
        found = run_episodes(self._env, controller(parameters), episodes, at, self._steps)
        self.played += episodes
        return list(self._goal(found))

    def final(self, parameters: Parameters) -> Episodes:
        """Play the final episodes."""
        env = self._make(num_envs=FINAL)
        at = first_seed(Stream.FINAL, 0)
        return run_episodes(env, controller(parameters), FINAL, at, self._steps)


def tune(robot: Robot, sampler: BaseSampler, episodes: int) -> Parameters:
    """Return the best parameters that so many episodes find."""
    study = optuna.create_study(direction="maximize", sampler=sampler)
    study.enqueue_trial(KNOWN)
    known: list[tuple[Parameters, list[float]]] = []
    while robot.played + EACH <= SEARCH * episodes:
        trial = study.ask()
        parameters = {
            f"{name}_{axis}": trial.suggest_float(f"{name}_{axis}", low, high, log=log)
            for name, (low, high, log) in RANGES.items()
            for axis in AXES
        }
        known.append((parameters, robot.values(parameters, EACH)))
        study.tell(trial, float(np.mean(known[-1][1])))
    known.sort(key=lambda candidate: -float(np.mean(candidate[1])))
    for i, (parameters, values) in enumerate(known[:FINALISTS]):
        left = (episodes - robot.played) // (min(FINALISTS, len(known)) - i)
        values += robot.values(parameters, left) if left else []
    return max(known[:FINALISTS], key=lambda candidate: float(np.mean(candidate[1])))[0]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for every method and number of episodes, and one for the controller as it is."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--episodes", type=int, nargs="+", default=[60, 200])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--scenario", default="misaligned")
    options = parser.parse_args(arguments)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    torch.set_num_threads(1)
    print(
        "| episodes | method | solved of 100 final episodes, by seed | success |\n|---|---|---|---|"
    )
    show(0, "the controller as it is", [Robot(options.scenario, "return", 0).final(KNOWN)])
    for episodes in options.episodes:
        for method, goal in product(METHODS, GOALS):
            robots = [Robot(options.scenario, goal, seed) for seed in range(options.seeds)]
            best = [tune(r, METHODS[method](seed), episodes) for seed, r in enumerate(robots)]
            found = [robot.final(b) for robot, b in zip(robots, best, strict=True)]
            show(episodes, f"{method}, for {goal}", found)


def show(episodes: int, method: str, found: Sequence[Episodes]) -> None:
    """Print a row."""
    solved = [int(_success(each).sum()) for each in found]
    low, high = (100 * bound for bound in rate_interval(solved, FINAL))
    rate, each = 100 * np.mean(solved) / FINAL, ", ".join(map(str, solved))
    print(f"| {episodes} | {method} | {each} | {rate:.0f} [{low:.0f}, {high:.0f}] % |", flush=True)


def _success(found: Episodes) -> Values:
    assert found.success is not None  # the task reports it
    return found.success.astype(float)


if __name__ == "__main__":
    main()
