"""How often the intervals cover what they say: ``python benchmarks/coverage.py``, an hour.

Fewer studies and shares take minutes; ``docs/reproduction.md`` has such a table.

Runs have success rates from a beta distribution with the given mean and standard deviation, and
all play the same 100 episodes. An episode's difficulty decides the given share of its outcomes, luck
the others. A cell is the share of simulated studies whose 95 % interval holds the mean, and the
interval's mean width. A spread of 10 points around 99 % is impossible.
"""

from __future__ import annotations

import argparse

import numpy as np

from rrl.trainers.evaluation.statistics import paired_interval, success_interval, unpaired_interval

EPISODES = 100
MEANS = (0.5, 0.7, 0.9, 0.95, 0.99)
SPREADS = (0.0, 0.02, 0.05, 0.1)
RUNS = (3, 5, 10)
ALIKE = (0.0, 0.5, 1.0)


def rates(mean: float, spread: float, shape: tuple[int, ...], rng: np.random.Generator):
    """Draw success rates of runs."""
    if spread == 0:
        return np.full(shape, mean)
    size = mean * (1 - mean) / spread**2 - 1
    return rng.beta(mean * size, (1 - mean) * size, shape)


def outcomes(solved: np.ndarray, alike: float, rng: np.random.Generator) -> np.ndarray:
    """Play the same episodes in every run.

    Args:
        solved: The rates of runs ``[S, 1]``.
        alike: Share of outcomes that the episode's difficulty decides.
        rng: Draws.
    """
    own, difficulty = rng.random((len(solved), EPISODES)), rng.random(EPISODES)
    return solved > np.where(rng.random(own.shape) < alike, difficulty, own)


def success_coverage(
    mean: float, spread: float, runs: int, studies: int, seed: int = 0, alike: float = 0.0
) -> tuple[float, float]:
    """Return coverage and mean width of :func:`success_interval`."""
    rng = np.random.default_rng(seed)
    studied = rates(mean, spread, (studies, runs, 1), rng)
    found = np.array([success_interval(outcomes(study, alike, rng)) for study in studied])
    return _coverage(found, mean)


def paired_coverage(
    controller: float,
    policy: float,
    spread: float,
    runs: int,
    studies: int,
    seed: int = 0,
    tasks: int = 1,
) -> tuple[float, float]:
    """Return coverage and mean width of :func:`paired_interval` of a gain in success.

    An episode's difficulty is one uniform number for all, and half of a policy's outcomes depend on
    it. The gain is the mean of so many tasks.
    """
    rng = np.random.default_rng(seed)

    def differences() -> np.ndarray:
        difficulty = rng.random(EPISODES)
        solved = rates(policy, spread, (runs, 1), rng) > np.where(
            rng.random((runs, EPISODES)) < 0.5, difficulty, rng.random((runs, EPISODES))
        )
        return solved.astype(float) - (controller > difficulty)

    tables = [[differences() for _ in range(tasks)] for _ in range(studies)]
    found = [paired_interval(*table, bound=1.0) for table in tables]
    return _coverage(np.array(found), policy - controller)


def unpaired_coverage(
    controller: float, policy: float, spread: float, runs: int, studies: int, seed: int = 0
) -> tuple[float, float]:
    """Return the same of :func:`unpaired_interval`, where every run has episodes of its own."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(studies):
        solved = rng.random((runs, EPISODES)) < rates(policy, spread, (runs, 1), rng)
        alone = rng.random((runs, EPISODES)) < controller
        found.append(unpaired_interval(solved, alone, bound=1.0))
    return _coverage(np.array(found), policy - controller)


def _coverage(intervals: np.ndarray, truth: float) -> tuple[float, float]:
    low, high = intervals.T
    return float(np.mean((low <= truth) & (truth <= high))), float(np.mean(high - low))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--studies", type=int, default=2000, help="simulated studies a cell")
    parser.add_argument("--alike", type=float, nargs="+", default=ALIKE, help="shares, see above")
    arguments = parser.parse_args()
    studies, shares = arguments.studies, arguments.alike
    cells = [(m, s) for m in MEANS for s in SPREADS if s**2 < m * (1 - m)]
    print(f"coverage [%] (mean width [points]) of success_interval, {studies} studies a cell\n")
    header = [f"{n} runs, {alike:.0%} alike" for n in RUNS for alike in shares]
    print("| mean [%] | spread [points] | " + " | ".join(header) + " |")
    print("|---|---|" + "---|" * len(header))
    for mean, spread in cells:
        found = [
            success_coverage(mean, spread, runs, studies, alike=alike)
            for runs in RUNS
            for alike in shares
        ]
        row = " | ".join(f"{100 * c:.1f} ({100 * w:.1f})" for c, w in found)
        print(f"| {100 * mean:g} | {100 * spread:g} | {row} |", flush=True)
    pairs = [(0.1, 0.8), (0.5, 0.9), (0.9, 0.95), (0.9, 0.99), (0.95, 0.95)]
    for name, simulate in (("paired", paired_coverage), ("unpaired", unpaired_coverage)):
        print(f"\nthe same of {name}_interval, policy less controller\n")
        print("| controller, policy [%] | spread [points] | 1 run | 3 runs | 10 runs |")
        print("|---|---|---|---|---|")
        for controller, policy in pairs:
            for spread in (0.0, 0.02, 0.05):
                found = [
                    simulate(controller, policy, spread if n > 1 else 0.0, n, studies)
                    for n in (1, 3, 10)
                ]
                row = " | ".join(f"{100 * c:.1f} ({100 * w:.1f})" for c, w in found)
                print(f"| {100 * controller:g}, {100 * policy:g} | {100 * spread:g} | {row} |")


if __name__ == "__main__":
    main()
