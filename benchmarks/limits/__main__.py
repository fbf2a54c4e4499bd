"""Whether the safety limits hold, under the worst commands that can be thought of.

Plays episodes of full speed into table and blocks, oscillations, random commands, and commands that the cross-entropy
method has optimized for harm, through the limits of ``configs/safety``: each of them alone, and all together. Prints the
largest value that was measured of what each promises, and fails if one is above the limit:

    python -m benchmarks.limits --episodes 10000 --record docs/data/limits.jsonl

``delay`` has all sensors of the limits two control steps late, ``stiff`` and ``soft`` an arm whose stiffness is a fifth
off. Nothing ends an episode before its time. What stands in the record is not played again, so that an interrupted
measurement goes on, and a later one with more episodes adds to it.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np
import torch

from .commands import BATCH, SCRIPTED
from .measure import GENERATIONS, excesses, measure, promised_by, promises
from .play import CASES, WATCHED
from .record import Key, Record

LIMITS = [*WATCHED, "all"]
VARIANTS = ["sim", "real"]
ROUND = BATCH * (len(SCRIPTED) + GENERATIONS)
"""Episodes of a round."""


def main() -> None:
    """Measure, print, and fail if a limit did not hold."""
    options = arguments()
    torch.set_num_threads(1)
    record = Record(options.record, {variant: promises(variant) for variant in VARIANTS})
    rounds = -(-options.episodes // (ROUND * len(LIMITS)))
    chosen = itertools.product(range(rounds), options.cases, options.variants, LIMITS)
    for seed, case, variant, name in chosen:
        key = Key(variant, case, name, seed)
        if key not in record.rounds:
            record.add(key, measure(variant, name, CASES[case], seed))
    table(record)
    failures = [
        f"{case}: {text}"
        for (variant, case, name), found in record.joined().items()
        for text in excesses(variant, name, found)
    ]
    print("\n".join(failures) or "No limit was exceeded.")
    sys.exit(bool(failures))


def arguments() -> argparse.Namespace:
    """Return what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--episodes", type=int, default=10000, help="of each variant and case, over all limits"
    )
    parser.add_argument("--variants", nargs="+", default=VARIANTS, choices=VARIANTS)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--record", type=Path, help="file of the rounds played, and to be played")
    return parser.parse_args()


def table(record: Record) -> None:
    """Print the largest of what each limit promises, in a row for every variant and case."""
    joined = record.joined()
    columns = [f"{name}: {value}" for name in LIMITS for value in promised_by(name)]
    print(f"| variant | case | episodes | {' | '.join(columns)} |")
    print("|---" * (3 + len(columns)) + "|")
    for variant, case in dict.fromkeys(key[:2] for key in joined):
        episodes, cells = 0, []
        for name in LIMITS:
            worsts = joined.get((variant, case, name), {}).values()
            episodes += sum(worst.episodes for worst in worsts)
            for value in promised_by(name):
                largest = [worst.values[value] for worst in worsts]
                cells.append(f"{np.max(largest):.2f}" if largest else "")
        print(f"| {variant} | {case} | {episodes} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
