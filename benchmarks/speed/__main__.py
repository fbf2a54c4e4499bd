"""``make benchmark``: every contender in turn, round after round, on the same task with the same settings.

    python -m benchmarks.speed                       # one run on all cores, three rounds
    python -m benchmarks.speed --seeds 10            # ten seeds: peers in two processes of one thread each
    python -m benchmarks.speed --success 0.9         # also the time until 90 % of the frozen episodes are solved, here
                                                     # of `rrl train` as it comes, too; round k trains seed k
    python -m benchmarks.speed env=insertion-sim     # an override of `rrl train`, for all

Peers come with ``pip install rrl[benchmark]``; one that is not there is left out. All get flushed denormal numbers, and
the machine's cores: a single run of a peer as threads, ours as the process that collects beside the updates. Absolute
figures belong to the machine, ratios travel; on a machine that does other work too, read the column "processor": of all
threads of the busiest process, which nobody else's work lengthens much.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markdown import Markdown

from benchmarks.speed.report import chart, table
from rrl.threads import cores

NEEDS = {"sb3": "stable_baselines3", "sbx": "sbx"}
PEERS = ["sb3", "sbx", "cleanrl", "torchrl"]


def plan(seeds: int) -> dict[str, list[list[str]]]:
    """The processes of every contender, as arguments of :mod:`.contenders`."""
    peers = {name: [name] for name in PEERS if importlib.util.find_spec(NEEDS.get(name, "torch"))}
    if seeds == 1:
        return {
            "rrl": [["rrl"]],
            "rrl-plain": [["rrl-plain"]],
            **{name: [args] for name, args in peers.items()},
        }
    half = seeds // 2
    stacks = [  # as many processes as the peers'
        ["rrl", "--stack", str(half), "--seed", str(first), "trainer.overlap=false"]
        for first in (0, half)
    ]
    pairs = {name: [[*args, "--seed", str(k)] for k in range(2)] for name, args in peers.items()}
    stack = ["rrl", "--stack", str(seeds), "trainer.overlap=false"]
    return {"rrl-stack": [stack], "rrl-stacks": stacks, **pairs}


def run(processes: list[list[str]], common: list[str]) -> dict[str, Any]:
    """Run a contender's processes side by side; seed-steps a second of all together."""
    threads = str(max(1, cores() // len(processes)))
    environment = {**os.environ, "OMP_NUM_THREADS": threads, "MKL_NUM_THREADS": threads}
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.speed.contenders"]
    started = [
        subprocess.Popen(
            [*command, *arguments, *common], stdout=subprocess.PIPE, text=True, env=environment
        )
        for arguments in processes
    ]
    outputs = [process.communicate()[0] for process in started]
    if any(process.returncode for process in started):
        raise RuntimeError(
            f"{processes[0][0]} failed with {[process.returncode for process in started]}"
        )
    found = [json.loads(output.splitlines()[-1]) for output in outputs]
    stacks = [int(a[a.index("--stack") + 1]) if "--stack" in a else 1 for a in processes]
    pairs = list(zip(found, stacks, strict=True))
    return {
        "steps_per_second": sum(m["steps_per_second"] * stack for m, stack in pairs),
        "processor_ms_per_step": 1 / sum(stack / m["processor_ms_per_step"] for m, stack in pairs),
        "first_update_s": max(m["first_update_s"] for m in found),
        "peak_mb": sum(m["peak_mb"] for m in found),
        "curve": found[0]["curve"],
    }


def main() -> None:
    """Measure, print the table, write table, figures and raw numbers."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=3000, help="environment steps of one seed")
    parser.add_argument("--warmup", type=int, default=500, help="of them before the first update")
    parser.add_argument("--seeds", type=int, default=1, choices=(1, 10))
    parser.add_argument(
        "--success",
        type=float,
        help="success rate whose time is reported; 10000 steps of a seed a round",
    )
    parser.add_argument("--only", nargs="+", default=[], help="contenders; sb3 is always one")
    parser.add_argument("--out", type=Path, default=Path("outputs/benchmark"))
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_intermixed_args()
    if options.success and options.seeds > 1:
        sys.exit("--success looks at one seed a round: expected --seeds 1")
    if options.success:  # with the warm-up that belongs to each algorithm
        common = ["trainer.total_steps=10000", "--every", "1000"]
    else:
        common = [f"trainer.total_steps={options.steps}", f"trainer.warmup_steps={options.warmup}"]
    common += options.overrides
    contenders = plan(options.seeds) | (
        {"rrl-default": [["rrl-default"]]} if options.success else {}
    )
    if options.only:
        contenders = {
            name: contenders[name] for name in contenders if name in {*options.only, "sb3"}
        }
    if "sb3" not in contenders:
        sys.exit(
            "the ratios are to Stable-Baselines3, which is not installed: pip install 'rrl[benchmark]'"
        )
    console, rounds = Console(), {name: [] for name in contenders}
    for number in range(options.rounds):
        for name, processes in contenders.items():
            seed = ["--seed", str(number)] if options.success else []
            rounds[name].append(run(processes, [*common, *seed]))
            speed = rounds[name][-1]["steps_per_second"]
            console.print(f"round {number + 1}: {name} {speed:.0f} steps/s", highlight=False)
    options.out.mkdir(parents=True, exist_ok=True)
    text = table(rounds, options.success)
    name = f"speed_{options.seeds}_seed{'s' if options.seeds > 1 else ''}"
    (options.out / f"{name}.md").write_text(text + "\n", encoding="utf-8")
    (options.out / f"{name}.json").write_text(json.dumps(rounds, indent=1), encoding="utf-8")
    chart(rounds, "one run" if options.seeds == 1 else f"{options.seeds} seeds", options.out / name)
    console.print(Markdown(text))


if __name__ == "__main__":
    main()
