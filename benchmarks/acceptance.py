"""What the acceptance of policies guarantees and costs: ``python benchmarks/acceptance.py``.

Three tables, in a few minutes. How often a run of candidates that are all worse than the
controller by exactly the margin accepts any of them; how many pairs of episodes a policy needs; and
what is handed over under other rules of when a candidate is tested. Episodes are beta-binomial: the
controller's probability of solving one is drawn from a beta distribution.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from rrl.trainers.evaluation.sequential import ErrorBudget, NotWorseTest
from rrl.trainers.settings import AcceptanceSettings

DEFAULT = AcceptanceSettings()
FAILURE = 6.0
"""Ranges of the controller's returns that a rare failure costs, as of a lander that crashes."""

Floats = NDArray[np.float64]


def pairs(
    controller: float, policy: float, count: int, rng: np.random.Generator, alike: float = 0.5
) -> Floats:
    """Draw differences in success of ``count`` pairs of episodes.

    Args:
        controller: Success rate of the controller.
        policy: Success rate of the policy.
        count: How many.
        rng: Draws them.
        alike: Probability that one number decides for both whether they solve an episode, as in
            frozen episodes; 0: the episodes are not frozen.
    """
    if 0 < controller < 1:
        rates = rng.beta(2 * controller, 2 * (1 - controller), count)
    else:
        rates = np.full(count, controller)
    # The policy's rate moves in proportion, so that its mean is exact and it stays within 0 and 1.
    if policy <= controller:
        moved = rates * (policy / controller if controller else 1.0)
    else:
        moved = 1 - (1 - rates) * (1 - policy) / (1 - controller)
    mine, other = rng.random(count), rng.random(count)
    other = np.where(rng.random(count) < alike, mine, other)
    return (other < moved).astype(float) - (mine < rates)


def skewed(controller: float, policy: float, count: int, rng: np.random.Generator) -> Floats:
    """Draw differences in return with the same mean: mostly a little better, seldom a lot worse."""
    return rare_failures(controller, policy, count, rng, loss=1.0)


def rare_failures(
    controller: float, policy: float, count: int, rng: np.random.Generator, loss: float = FAILURE
) -> Floats:
    """Draw differences in return: a little better, but for failures that cost several ranges."""
    gain = 0.02
    rare = (gain - (policy - controller)) / (loss + gain)
    return np.where(rng.random(count) < rare, -loss, gain)


DRAWS: dict[str, tuple[Callable[..., Floats], float]] = {
    "frozen": (pairs, 1.0),
    "not frozen": (partial(pairs, alike=0.0), 1.0),
    "skewed returns": (skewed, 1.0),
    "rare failures": (rare_failures, FAILURE),
}
"""Ways to draw differences from controller, policy, count, rng, and the largest loss of each."""


def run(
    curve: Iterable[float], controller: float, draw: str, rng: np.random.Generator
) -> list[NotWorseTest]:
    """Return the tests of candidates with these success rates, in one run."""
    budget, tests = ErrorBudget(DEFAULT.alpha), []
    differences, largest = DRAWS[draw]
    for policy in curve:
        test = budget.test(DEFAULT.margin / largest)
        test.add(differences(controller, policy, DEFAULT.episodes, rng) / largest)
        budget.settle(test)
        tests.append(test)
    return tests


def false_acceptance(
    controller: float, draw: str, candidates: int, good: float, runs: int, seed: int = 0
) -> float:
    """Return the share of runs that accept a policy that is worse by exactly the margin.

    Args:
        controller: Success rate of the controller.
        draw: Name of a way to draw episodes.
        candidates: How many policies a run tests.
        good: Share of them that are much better than the controller, at random places.
        runs: How many runs are simulated.
        seed: Of the simulation.
    """
    rng = np.random.default_rng(seed)
    worse, better = controller - DEFAULT.margin, min(1.0, controller + 0.4)
    wrong = 0
    for _ in range(runs):
        is_good = rng.random(candidates) < good
        tests = run(np.where(is_good, better, worse), controller, draw, rng)
        wrong += any(test.accepted and not g for test, g in zip(tests, is_good, strict=True))
    return wrong / runs


def power(
    controller: float, policy: float, draw: str, runs: int, seed: int = 0
) -> tuple[float, float]:
    """Return the share of first candidates that are accepted, and the mean number of pairs."""
    rng = np.random.default_rng(seed)
    tests = [run([policy], controller, draw, rng)[0] for _ in range(runs)]
    return float(np.mean([t.accepted for t in tests])), float(np.mean([t.episodes for t in tests]))


RULES = {
    "better than what is handed over": lambda found, now, best, alone: found > now,
    "at most the margin below the best": lambda found, now, best, alone: found > best - 0.05,
    "not below the controller": lambda found, now, best, alone: found >= alone,
}
"""When a candidate is tested, by successes on the followed episodes; the first one is ours."""
FOLLOWED = 50
CURVES = {
    "rises above 30 %": (0.3, 0.05, np.linspace(0.2, 0.95, 10)),
    "falls below 90 %, then rises": (
        0.9,
        0.02,
        np.array([0.3, 0.5, 0.7, 0.85, 0.92, 0.95, 0.96, 0.97, 0.97, 0.97]),
    ),
    "rises above 20 %, then collapses": (
        0.2,
        0.02,
        np.array([0.5, 0.8, 0.9, 0.92, 0.9, 0.6, 0.3, 0.2, 0.25, 0.25]),
    ),
    "stays 20 points below 80 %": (0.8, 0.05, np.full(10, 0.6)),
    "stays at the controller's 100 %": (1.0, 0.0, np.ones(10)),
}
"""Controller's success rate, spread of a run's curve about the mean one, and the mean one."""


def rule(name: str, curve: str, runs: int, seed: int = 0) -> tuple[float, float]:
    """Return the success rate of what is handed over at the end, and the pairs played, means."""
    rng, (controller, spread, mean) = np.random.default_rng(seed), CURVES[curve]
    ends, played = [], 0
    for _ in range(runs):
        budget, hardness = ErrorBudget(DEFAULT.alpha), rng.random(FOLLOWED)
        alone = best = now = (hardness < controller).mean()
        end = controller
        for policy in np.clip(mean + spread * rng.standard_normal(len(mean)), 0, 1):
            own = np.where(rng.random(FOLLOWED) < 0.5, hardness, rng.random(FOLLOWED))
            # Equal successes are told apart by the return, which says nothing here.
            found = (own < policy).mean() + 1e-6 * rng.standard_normal()
            if not RULES[name](found, now, best, alone):
                continue
            test = budget.test(DEFAULT.margin)
            test.add(pairs(controller, policy, DEFAULT.episodes, rng))
            budget.settle(test)
            played += test.episodes
            if test.accepted:
                now, best, end = found, max(best, found), policy
        ends.append(end)
    return float(np.mean(ends)), played / runs


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=2000, help="simulated runs a cell")
    runs = parser.parse_args().runs
    print(f"margin {DEFAULT.margin:g}, alpha {DEFAULT.alpha:g}, {DEFAULT.episodes} pairs at most\n")
    print("runs that accept a policy worse by exactly the margin [%], of 20 candidates each\n")
    print("| controller [%] | " + " | ".join(f"{d} | {d}, a third good" for d in DRAWS) + " |")
    print("|---|" + "---|" * 2 * len(DRAWS))
    for controller in (0.1, 0.5, 0.9):
        cells = [
            f"{100 * false_acceptance(controller, draw, 20, good, runs):.1f}"
            for draw in DRAWS
            for good in (0.0, 1 / 3)
        ]
        print(f"| {100 * controller:g} | " + " | ".join(cells) + " |", flush=True)
    print("\nfirst candidates that are accepted [%] (pairs of episodes that it took)\n")
    print("| controller, policy [%] | frozen | not frozen |")
    print("|---|---|---|")
    for controller, policy in (
        *((1.0, 1.0), (0.95, 0.95), (0.9, 0.9), (0.5, 0.5)),
        *((0.95, 1.0), (0.9, 0.95), (0.5, 0.55), (0.5, 0.7), (0.2, 0.9)),
        *((0.9, 0.8), (0.9, 0.5)),
    ):
        found = [power(controller, policy, d, runs // 4) for d in ("frozen", "not frozen")]
        cells = [f"{100 * share:.0f} ({count:.0f})" for share, count in found]
        print(f"| {100 * controller:g}, {100 * policy:g} | " + " | ".join(cells) + " |", flush=True)
    print("\nsuccess of what is handed over after ten candidates [%] (pairs played in the run)\n")
    print("| a candidate is tested if it is | " + " | ".join(CURVES) + " |")
    print("|---|" + "---|" * len(CURVES))
    for name in RULES:
        found = [rule(name, curve, runs // 8) for curve in CURVES]
        print(f"| {name} | " + " | ".join(f"{100 * s:.1f} ({n:.0f})" for s, n in found) + " |")


if __name__ == "__main__":
    main()
