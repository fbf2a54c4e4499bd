"""Learners that are killed: what is lost, what is stored twice, and whether the robot stands still."""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path

from rrl.trainers.storage.transition_log import TransitionLog
from rrl.trainers.training.realtime.hand_over import HandOver

from .plants import plant, training

RATE, STEPS = 20, 10_000_000
LONGEST_LIFE, LONGEST_START = 4.0, 300.0
"""Seconds until a learner dies, at most: three of four after they have given the first weights, the others after their
process has begun; and how long one may take to begin."""


def kill_learners(out: Path, kills: int, seed: int) -> dict[str, float]:
    """Kill so many learners of one run, then stop the last one as a user does, and count."""
    import rrl.trainers.cli.train  # noqa: F401 - what the children need is imported once, here

    out.mkdir(parents=True)
    address, rng = f"ipc://{out}/plant", random.Random(seed)
    with plant(address, RATE):
        alive = 0
        for kill in range(kills):
            child = start_learner(out, address)
            if kill % 4 != 3:
                wait_for_weights(out)
            time.sleep(rng.uniform(0.0, LONGEST_LIFE))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            alive += HandOver(out / "run/realtime").is_alive()
        child = start_learner(out, address)
        wait_for_weights(out)
        time.sleep(LONGEST_LIFE)
        os.kill(child, signal.SIGTERM)
        os.waitpid(child, 0)
    return {"kills that the acting process survived": alive, **count(out)}


def wait_for_weights(out: Path) -> None:
    """Wait until a learner gives weights."""
    hand_over = HandOver(out / "run/realtime")
    hand_over.new_weights()
    ends = time.monotonic() + LONGEST_START
    while hand_over.new_weights() is None:
        if time.monotonic() > ends:
            raise SystemExit(f"no learner began: see {out / 'output.txt'}")
        time.sleep(0.02)


def start_learner(out: Path, address: str) -> int:
    """Begin or resume the run in a child process; return its id."""
    run_dir = out / "run"
    begun = list((run_dir / "checkpoints").glob("checkpoint-*")) if run_dir.is_dir() else []
    arguments = [f"resume={run_dir}"] if begun else training(run_dir, address, RATE, STEPS)
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    output = os.open(out / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    from rrl.trainers.cli.main import main

    os._exit(main(["train", *arguments]))


def logs(out: Path) -> tuple[TransitionLog, TransitionLog]:
    """The learner's transitions, and those of the acting process."""
    return tuple(TransitionLog(out / "run" / f / "transitions") for f in ("", "realtime"))  # type: ignore[return-value]


def count(out: Path) -> dict[str, float]:
    """Compare what the learners stored with what was acted."""
    learner, acted = logs(out)
    stored, damaged = learner.read(0, learner.count)
    made, torn = acted.read(0, acted.count)
    when = made["timing", "time"].flatten()
    first = made["timing", "first"].flatten()
    same = (stored["end_effector_position"] == made["end_effector_position"][: len(stored)]).all(-1)
    same &= (stored["action"] == made["action"][: len(stored)]).all(-1)
    within = when.diff()[~first[1:]]
    return {
        "transitions made": len(made),
        "transitions stored by learners": len(stored),
        "transitions lost": int((~same).sum()) + len(damaged) + len(torn),
        "transitions stored twice": len(when) - len(when.unique()),
        "longest time between two steps of an episode [ms]": 1e3 * float(within.max()),
        "longest time between two steps, resets included [ms]": 1e3 * float(when.diff().max()),
    }
