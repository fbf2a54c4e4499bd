"""How punctual the acting process is while the learner learns."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import torch

from rrl.trainers.storage.transition_log import TransitionLog

from .plants import ROOT, plant, training


def measure(out: Path, rate: int, seconds: float) -> dict[str, float]:
    """Train for so many seconds of motion; return what the acting process measured of itself."""
    out.mkdir(parents=True)
    steps = round(seconds * rate / 50) * 50
    address = f"ipc://{out}/plant"
    log = TransitionLog(out / "run/realtime/transitions")
    with plant(address, rate):
        arguments = training(out / "run", address, rate, steps)
        command = [sys.executable, "-m", "rrl.trainers", "train", *arguments]
        learner = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL)
        while log.refresh() < steps and learner.poll() is None:
            time.sleep(0.5)
        learner.kill()  # what it has not learned from does not matter here
        learner.wait()
    if log.count < steps:
        raise SystemExit(f"expected {steps} steps, got {log.count}: the training has ended")
    timing = log.read(0, log.count)[0]["timing"][200:]  # while the learner learns
    rows: dict[str, float] = {"steps": len(timing)}
    for name, values in {
        "period error": 1e3 * timing["period_error"].flatten().abs(),
        "inference": 1e3 * timing["inference"].flatten(),
    }.items():
        p50, p99 = torch.quantile(values, torch.tensor([0.5, 0.99], dtype=values.dtype)).tolist()
        rows |= {
            f"{name}, p50 [ms]": p50,
            f"{name}, p99 [ms]": p99,
            f"{name}, max [ms]": float(values.max()),
        }
    rows["p99 of the period error, of the period [%]"] = rows["period error, p99 [ms]"] * rate / 10
    rows["missed deadlines"] = int(timing["missed"].sum())
    rows["faults"] = int(timing["faults"].sum())
    return rows
