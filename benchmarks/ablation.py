"""What every switch for sample efficiency does: TD3 with each one added, td3-ensemble with each one removed.

Runs are kept in a store, so that a second call does what is missing and arms that are equal share their runs:

    python benchmarks/ablation.py                          # three seeds
    python benchmarks/ablation.py removed scale=full       # ten seeds, one of the two tables
    python benchmarks/ablation.py env=insertion-sim        # an override of `rrl train`, for every run

The tables go to the terminal and to ``ablation.md`` in the store.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from rrl.trainers.cli import main as cli
from rrl.trainers.evaluation.statistics import mean_interval
from rrl.trainers.experiments.outcomes import Finding, Outcome, gather
from rrl.trainers.experiments.plan import plan_jobs, plan_points
from rrl.trainers.experiments.spec import Experiment, Settings, load_experiments, load_settings
from rrl.trainers.launch.display import Display
from rrl.trainers.launch.launchers import make
from rrl.trainers.launch.pool import run_jobs, tail
from rrl.trainers.launch.store import Store
from rrl.trainers.training.interruption import Interrupted

FOLDER = Path(__file__).parent / "ablation"
COMMAND = ("scale", "launcher", "workers", "out")


def main(arguments: Sequence[str]) -> int:
    """Run what is missing and write the tables; returns the exit status."""
    settings, experiments = read(arguments)
    store = Store(Path(settings.out))
    points = plan_points(experiments, settings, partial(cli._compose, [FOLDER]))
    launcher = make(settings.launcher, settings.workers)
    try:
        jobs = plan_jobs(points, store, settings.scales[settings.scale].stack, launcher.slots)
        ending = run_jobs(jobs, store, launcher, Display(Console()))
    except Interrupted as interrupted:
        print(f"stopped; what was done is in {store.out}, and the same command goes on")
        return 128 + interrupted.signal
    finally:
        launcher.close()
    for job in ending.failed:
        print(f"FAILED {job.run.name}\n{tail(job.run)}")
    findings = gather(points, store)
    text = "\n\n".join(
        markdown(e, findings[e.name]) for e in experiments if findings[e.name].outcomes
    )
    command = " ".join(["python benchmarks/ablation.py", *arguments])
    (store.out / "ablation.md").write_text(f"{text}\n\nMade by `{command}`.\n", encoding="utf-8")
    print(text)
    return 1 if ending.failed else 0


def read(arguments: Sequence[str]) -> tuple[Settings, list[Experiment]]:
    """Settings and experiments: names of experiments, settings of the command, overrides of ``rrl train``."""
    names = [a for a in arguments if "=" not in a]
    ours = [a for a in arguments if a.partition("=")[0] in COMMAND]
    changes: dict[str, Any] = {
        key: yaml.safe_load(value) for key, _, value in (a.partition("=") for a in ours)
    }
    settings = load_settings([FOLDER], changes)
    overrides = tuple(a for a in arguments if "=" in a and a not in ours)
    return settings.model_copy(
        update={"overrides": (*settings.overrides, *overrides)}
    ), load_experiments(names, [FOLDER])


def markdown(experiment: Experiment, finding: Finding) -> str:
    """Success by arm after so many samples, and at the end in every scenario; per cent."""
    first = finding.outcomes[0]
    steps = [int(step) for step in first.curve("success").steps if step][:-1]
    header = [
        "",
        "seeds",
        *(f"{step} samples" for step in steps),
        *(f"end, {name}" for name in first.scenarios),
    ]
    rows = [_row(outcome, steps) for outcome in finding.outcomes]
    controller = ", ".join(
        f"{s} {100 * first.final('controller_success', s)[0]:.0f} %" for s in first.scenarios
    )
    lines = [header, ["---"] * len(header), *rows]
    return (
        f"## {experiment.title}\n\n"
        f"Success in per cent: mean over seeds [95 % interval, Student's t]. The controller alone: {controller}.\n\n"
        + "\n".join(f"| {' | '.join(line)} |" for line in lines)
    )


def _row(outcome: Outcome, steps: Sequence[int]) -> list[str]:
    curve = outcome.curve("success")
    at = {int(step): column for step, column in zip(curve.steps, curve.values.T, strict=True)}
    early = [_cell(at[step]) for step in steps if step in at]
    return [
        outcome.point.arm,
        str(len(outcome.seeds)),
        *early,
        *(_cell(outcome.final("success", s)) for s in outcome.scenarios),
    ]


def _cell(rates: Any) -> str:
    low, high = mean_interval(rates)
    return f"{100 * rates.mean():.1f} [{max(0.0, 100 * low):.0f}, {min(100.0, 100 * high):.0f}]"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
