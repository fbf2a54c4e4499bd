"""Kill a training run with SIGKILL, resume it, again and again, and compare what comes out with a run left in peace.

    python benchmarks/faults.py --kills 100

Every life of the run is a process of its own that executes ``rrl train`` with the command line's own entry point;
processes are forked from one that has imported everything, because start-up would take most of the time otherwise.
Every second kill waits until a checkpoint is being written and strikes within it. Afterwards the run that was killed
must equal the one that was not, to the last bit: learned parameters, optimizers, random generators, episode, stored
transitions, metrics. Exit status 1 if it does not, or if a single stored transition was lost.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from rrl.trainers.storage.transition_log import TransitionLog

SETTINGS = [
    "env=insertion-sim",
    "disturbance=noise",
    "logger=[csv,tensorboard]",
    "algorithm=td3",
    "algorithm.agent.network.hidden=[16,16]",
    "trainer.num_envs=2",
    "trainer.warmup_steps=40",
    "trainer.steps_per_collection=5",
    "trainer.updates_per_step=0.5",
    "trainer.batch_size=16",
    "trainer.buffer_capacity=300",  # wraps around
    "trainer.evaluation.every=100",
    "trainer.evaluation.episodes=2",
    "trainer.evaluation.final_episodes=2",
    "trainer.evaluation.slots=2",
    "trainer.acceptance.episodes=2",
    "trainer.checkpoint.every=20",
    "render.enabled=false",
]
LONGEST_LIFE = 4.0
"""Seconds; a life that is not killed while writing a checkpoint ends at a random moment before."""

MEASURE_TIME = ("clock/", "time/")
"""Metrics that differ from run to run."""

STRIKE = 0.02
"""Seconds between seeing a checkpoint begin and the kill, at most."""


def launch(run_dir: Path, steps: int) -> int:
    """Start or resume the run in a process of its own; returns its id."""
    arguments = [*SETTINGS, f"trainer.total_steps={steps}", f"hydra.run.dir={run_dir}"]
    if (run_dir / "config.yaml").exists():
        arguments = [f"resume={run_dir}"]
    run_dir.mkdir(parents=True, exist_ok=True)
    child = os.fork()
    if child:
        return child
    output = os.open(run_dir / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    from rrl.trainers.cli.main import main

    status = 1
    with contextlib.suppress(BaseException):
        status = main(["train", *arguments])
    sys.stdout.flush()
    os._exit(status)


def wait(child: int) -> None:
    """Wait for a process that is not killed; raise if it fails."""
    _, status = os.waitpid(child, 0)
    if status:
        raise SystemExit(
            f"the training process ended with status {os.waitstatus_to_exitcode(status)}"
        )


def kill(child: int, run_dir: Path, strike_at_checkpoint: bool, rng: random.Random) -> str:
    """Kill the process at a random moment; returns what it was doing, or "finished" if it was too late."""
    deadline = time.monotonic() + (
        2 * LONGEST_LIFE if strike_at_checkpoint else rng.uniform(0.0, LONGEST_LIFE)
    )
    strikes = not strike_at_checkpoint
    while time.monotonic() < deadline:
        if os.waitpid(child, os.WNOHANG) != (0, 0):
            return "finished"
        if not strikes and being_written(run_dir):
            time.sleep(rng.uniform(0.0, STRIKE))
            break
        time.sleep(0.0005)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if os.WIFEXITED(status):
        return "finished"
    if being_written(run_dir):
        return "inside a checkpoint's writing"
    return (
        "training"
        if list(run_dir.glob("checkpoints/checkpoint-*"))
        else "before the first checkpoint"
    )


def being_written(run_dir: Path) -> bool:
    """Whether a checkpoint is under way, or was when the process died."""
    return any((run_dir / "checkpoints").glob(".checkpoint-*"))


def lost_transitions(run_dir: Path) -> int:
    """Transitions that ``metrics.csv`` acknowledges and the log on disk does not hold intact."""
    from rrl.trainers.storage.transition_log import TransitionLog

    log = TransitionLog(run_dir / "transitions")
    acknowledged = max((rows[-1][0] for rows in metrics(run_dir).values()), default=0)
    first = min(
        (log._per_segment * int(p.stem[-6:]) for p in log.folder.glob("segment_*.bin")), default=0
    )
    damaged = log.read(first, log.count)[1] if log.count else []
    # A kill may fall between setting a tail aside and cutting the metrics down to the checkpoint.
    tails = (tail_content(tail, log) for tail in log.folder.glob("tail_*.bin"))
    held = [log.count, *((start + len(data)) // log._record.itemsize for start, data in tails)]
    return max(0, acknowledged - max(held)) + len(damaged)


def tail_content(tail: Path, log: TransitionLog) -> tuple[int, bytes]:
    """Whole transitions of a tail that was set aside, and the byte of the log they stood at."""
    size, content = log._record.itemsize, tail.read_bytes()
    return int(tail.stem.split("_")[1]) * size, content[: len(content) // size * size]


def metrics(run_dir: Path) -> dict[str, list[tuple[int, float]]]:
    """The metrics that do not measure time; none before there are any."""
    from rrl.trainers.loggers import read_metrics

    if not (run_dir / "metrics.csv").is_file():
        return {}
    rows = read_metrics(run_dir).items()
    return {name: values for name, values in rows if not name.startswith(MEASURE_TIME) and values}


def components(run_dir: Path) -> dict[str, Any]:
    """What the newest checkpoint holds, by component."""
    newest = sorted(run_dir.glob("checkpoints/checkpoint-*"))[-1]
    return {
        p.parent.name: torch.load(p, weights_only=True) for p in sorted(newest.rglob("state.pt"))
    }


def compare(whole: Path, broken: Path) -> dict[str, bool]:
    """Which parts of the two runs are the same, bit for bit."""
    same = {}
    theirs = components(broken)
    for name, state in components(whole).items():
        if (component := name.partition("-")[2]) != "clock":  # seconds differ from run to run
            same[component] = same_state(state, theirs[name])
    same["transitions"] = transitions(whole) == transitions(broken)
    same["metrics"] = metrics(whole) == metrics(broken) != {}
    same["transitions made twice"] = all(
        tail_made_again(path) for path in broken.glob("transitions/tail_*.bin")
    )
    return same


def transitions(run_dir: Path) -> bytes:
    """The log of transitions, whole."""
    return b"".join(p.read_bytes() for p in sorted(run_dir.glob("transitions/segment_*.bin")))


def tail_made_again(tail: Path) -> bool:
    """Whether the resumed run made the transitions of a tail again as they were."""
    from rrl.trainers.storage.transition_log import TransitionLog

    start, content = tail_content(tail, TransitionLog(tail.parent))
    return transitions(tail.parents[1])[start:].startswith(content)


def same_state(one: Any, other: Any) -> bool:
    """The same tensors and numbers, to the last bit, in nested containers."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same_state(one[key], other[key]) for key in one)
    if isinstance(one, (list, tuple)):
        return len(one) == len(other) and all(map(same_state, one, other))
    return torch.equal(one, other) if isinstance(one, torch.Tensor) else one == other


def main() -> int:
    """Run the campaign and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--steps", type=int, default=1000, help="environment steps of one seed")
    parser.add_argument("--seed", type=int, default=0, help="of the moments of the kills")
    parser.add_argument(
        "--out", type=Path, help="keep the runs here; a temporary folder when left out"
    )
    arguments = parser.parse_args()
    import torch.utils.tensorboard  # noqa: F401 - what the children need is imported once, here

    import rrl.envs
    import rrl.trainers.cli.train  # noqa: F401

    with contextlib.ExitStack() as stack:
        out = arguments.out or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        return campaign(
            out.resolve(), arguments.kills, arguments.steps, random.Random(arguments.seed)
        )


def campaign(out: Path, kills: int, steps: int, rng: random.Random) -> int:
    """Kill runs until ``kills`` have struck; compare each run that came to its end with the one left in peace."""
    start = time.monotonic()
    wait(launch(out / "whole", steps))
    struck: Counter[str] = Counter()
    lost = runs = 0
    verdicts: dict[str, bool] = {}
    while sum(struck.values()) < kills:
        run_dir = out / f"broken_{runs}"
        runs += 1
        while sum(struck.values()) < kills:
            doing = kill(launch(run_dir, steps), run_dir, sum(struck.values()) % 2 == 0, rng)
            if doing == "finished":
                break
            struck[doing] += 1
            lost += lost_transitions(run_dir)
        else:
            wait(launch(run_dir, steps))
        for name, same in compare(out / "whole", run_dir).items():
            verdicts[name] = verdicts.get(name, True) and same
    report(struck, lost, runs, verdicts, torn=len(list(out.glob("broken_*/checkpoints/*.torn"))))
    print(f"\n{time.monotonic() - start:.0f} s")
    return int(lost > 0 or not all(verdicts.values()))


def report(
    struck: Counter[str], lost: int, runs: int, verdicts: dict[str, bool], torn: int
) -> None:
    """Print the table."""
    rows = [(f"SIGKILL {doing}", str(count)) for doing, count in struck.most_common()]
    rows += [
        ("SIGKILL in all", str(sum(struck.values()))),
        ("runs brought to their end", str(runs)),
    ]
    rows += [
        ("stored transitions lost", str(lost)),
        ("published checkpoints found torn", str(torn)),
    ]
    rows += [
        (f"same as uninterrupted: {name}", "yes" if same else "NO")
        for name, same in verdicts.items()
    ]
    for name, value in rows:
        print(f"| {name:<48} | {value:>5} |")
    print(json.dumps({"kills": sum(struck.values()), "lost": lost, "same": all(verdicts.values())}))


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    torch.set_num_threads(1)
    sys.exit(main())
