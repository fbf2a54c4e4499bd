"""Whether the fast settings learn what the plain ones learn: the same seeds, trained both ways.

Fast: 50 steps a collection, collected while the updates run, compiled updates, bfloat16 products where the processor
has them. Plain: one step a collection, in turn, eager, float32.

    python -m benchmarks.learning                                       # ten seeds each, the whole training
    python -m benchmarks.learning --seeds 3 env=insertion-sim trainer.total_steps=3000   # a look at it

The intervals are Student's, of the mean over seeds; that of the difference is Welch's. They say the same when the
difference's interval holds 0.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy import stats

from benchmarks.speed.contenders import FAST, PLAIN
from benchmarks.speed.task import configuration
from rrl.trainers.configuration import build as assembly

WAYS = {"fast": FAST, "plain": PLAIN}


def train(
    way: str, seeds: int, out: Path, overrides: list[str]
) -> tuple[dict[str, np.ndarray], float]:
    """Success rates by scenario, one a seed, and the seconds that it took."""
    config = configuration([f"trainer.num_seeds={seeds}", *overrides, *WAYS[way]])
    start = time.perf_counter()
    with assembly.trainer(config, out / way) as trainer:
        results = trainer.run()
    seconds = time.perf_counter() - start
    return {
        name: np.array([c.summary()["success"] for c in found]) for name, found in results.items()
    }, seconds


def interval(values: np.ndarray) -> str:
    """Mean and 95 % interval, in per cent."""
    bounds = stats.t.interval(0.95, len(values) - 1, values.mean(), max(stats.sem(values), 1e-12))
    low, high = np.clip(bounds, 0, 1)
    return f"{values.mean():.1%} [{low:.1%}, {high:.1%}]"


def main() -> None:
    """Train both ways, compare."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument(
        "--out", type=Path, default=Path("outputs/learning") / time.strftime("%Y-%m-%d_%H-%M-%S")
    )
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_intermixed_args()
    found = {way: train(way, options.seeds, options.out, options.overrides) for way in WAYS}
    table = Table(
        "scenario",
        *(f"{way} ({seconds:.0f} s)" for way, (_, seconds) in found.items()),
        "difference",
    )
    for scenario in found["fast"][0]:
        fast, plain = (found[way][0][scenario] for way in ("fast", "plain"))
        if fast.std() + plain.std() > 0:
            low, high = stats.ttest_ind(fast, plain, equal_var=False).confidence_interval(0.95)
        else:
            low = high = fast.mean() - plain.mean()
        difference = f"{fast.mean() - plain.mean():+.1%} [{low:+.1%}, {high:+.1%}]"
        table.add_row(scenario, interval(fast), interval(plain), difference)
    Console().print(table)


if __name__ == "__main__":
    main()
