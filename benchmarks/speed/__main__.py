"""``make benchmark``: every contender in turn, round after round, on the same task with the same settings.

    python -m benchmarks.speed                       # one run on all cores, three rounds
    python -m benchmarks.speed --runs 2              # two runs side by side, processes of one thread each
    python -m benchmarks.speed --success 0.9         # also the time until 90 % of the frozen episodes are solved, here
                                                     # of `rrl train` as it comes, too; round k trains seed k
    python -m benchmarks.speed env=insertion-sim     # an override of `rrl train`, for all

Peers come with ``pip install -e '.[benchmark]'``; one that is not there is left out. All get flushed denormal numbers, and
the machine's cores: a single run of a peer as threads, ours as the process that collects beside the updates. Our fast
settings collect from several environments in one process; a row of its own gives them to Stable-Baselines3 too. Absolute
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

NEEDS = {"sb3": "stable_baselines3", "sb3-several": "stable_baselines3", "sbx": "sbx"}
PEERS = ["sb3", "sb3-several", "sbx", "cleanrl", "torchrl"]


def plan(runs: int) -> dict[str, list[list[str]]]:
    """The processes of every contender, as arguments of :mod:`.contenders`."""
    peers = [name for name in PEERS if importlib.util.find_spec(NEEDS.get(name, "torch"))]
    if runs == 1:
        return {name: [[name]] for name in ("rrl", "rrl-plain", *peers)}
    in_turn = {"rrl": ["trainer.collection=turn"]}  # a process that collects would be one too many
    return {
        name: [[name, "--seed", str(k), *in_turn.get(name, [])] for k in range(runs)]
        for name in ("rrl", *peers)
    }


def run(processes: list[list[str]], common: list[str]) -> dict[str, Any]:
    """Run a contender's processes side by side; steps a second of all together."""
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
    return {
        "steps_per_second": sum(m["steps_per_second"] for m in found),
        "processor_ms_per_step": 1 / sum(1 / m["processor_ms_per_step"] for m in found),
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
    parser.add_argument("--runs", type=int, default=1, help="side by side")
    parser.add_argument(
        "--success",
        type=float,
        help="success rate whose time is reported; 10000 steps of a seed a round",
    )
    parser.add_argument("--only", nargs="+", default=[], help="contenders; sb3 is always one")
    parser.add_argument("--out", type=Path, default=Path("outputs/benchmark"))
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_intermixed_args()
    if options.success and options.runs > 1:
        sys.exit("--success looks at one seed a round: expected --runs 1")
    if options.success:  # with the warm-up that belongs to each algorithm
        common = ["trainer.total_steps=10000", "--every", "1000"]
    else:
        common = [f"trainer.total_steps={options.steps}", f"trainer.warmup_steps={options.warmup}"]
    common += options.overrides
    contenders = plan(options.runs) | (
        {"rrl-default": [["rrl-default"]]} if options.success else {}
    )
    if options.only:
        contenders = {
            name: contenders[name] for name in contenders if name in {*options.only, "sb3"}
        }
    if "sb3" not in contenders:
        sys.exit(
            "the ratios are to Stable-Baselines3, which is not installed: pip install -e '.[benchmark]' in the clone"
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
    name = f"speed_{options.runs}_run{'s' if options.runs > 1 else ''}"
    (options.out / f"{name}.md").write_text(text + "\n", encoding="utf-8")
    (options.out / f"{name}.json").write_text(json.dumps(rounds, indent=1), encoding="utf-8")
    chart(
        rounds,
        "one run" if options.runs == 1 else f"{options.runs} runs side by side",
        options.out / name,
    )
    console.print(Markdown(text))


if __name__ == "__main__":
    main()
