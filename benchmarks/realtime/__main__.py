"""Measure the control period beside a learner, and kill learners.

    python -m benchmarks.realtime                        # 60 s of motion at 20 Hz and at 100 Hz, and 100 kills
    python -m benchmarks.realtime --seconds 600 --rates 20 --kills 0   # ten minutes at 20 Hz

Each part trains with the default algorithm on a plant, ``python -m rrl.envs.plant``, in processes of their own: plant,
acting process, learner. Exit status 1 if a transition was lost or stored twice.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from .kills import kill_learners
from .rates import measure


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.realtime", description=__doc__)
    parser.add_argument(
        "--rates",
        type=int,
        nargs="*",
        default=[20, 100],
        help="control steps a second (%(default)s)",
    )
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of motion with a learner at work (%(default)s)"
    )
    parser.add_argument("--kills", type=int, default=100, help="of the learner (%(default)s)")
    parser.add_argument(
        "--seed", type=int, default=0, help="of the moments of the kills (%(default)s)"
    )
    parser.add_argument("--out", type=Path, help="keeps the runs; a temporary folder if left out")
    chosen = parser.parse_args(arguments)
    with contextlib.ExitStack() as stack:
        out = chosen.out or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for rate in chosen.rates:
            rows = measure(out.resolve() / f"{rate}-hz", rate, chosen.seconds)
            show(f"{rate} Hz", rows)
        if not chosen.kills:
            return 0
        found = kill_learners(out.resolve() / "kills", chosen.kills, chosen.seed)
        show(f"{chosen.kills} learners killed", found)
        return int(found["transitions lost"] > 0 or found["transitions stored twice"] > 0)


def show(title: str, rows: dict[str, float]) -> None:
    """Print a table, and the same as JSON."""
    print(f"\n| {title} | |\n|---|---|")
    for name, value in rows.items():
        print(f"| {name} | {value:.6g} |")
    print(json.dumps({title: rows}), flush=True)


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
