"""Several seeds of one configuration: runs of their own in the pool, shown together at the end."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..configuration import build as assembly
from ..configuration.schema import Schema
from ..console import Output, from_here
from ..launch.job import Job, one_seed, write_config
from ..launch.pool import launch, require_all
from ..report.report import write_report
from ..report.runs import Group, Run, find_runs
from ..report.tables import most_rescued
from ..storage.checkpoints import saved_note
from ..storage.files import claimed
from ..storage.run_files import CHECKPOINTS, REPORT, seed_directories
from ..storage.same_run import require_same_run
from .evaluate import film_run, only_said, show


def train_seeds(config: assembly.Config, run_dir: Path, console: Output, *, resume: bool) -> None:
    """Train ``trainer.num_seeds`` runs ``seed-<n>`` below ``run_dir``, what is missing of them.

    Args:
        config: The resolved configuration, checked.
        run_dir: Directory of all seeds.
        console: Where to show the progress.
        resume: Whether the directory may hold runs already.

    Raises:
        BlockingIOError: If another process trains here.
        FileExistsError: If there are runs already, and ``resume`` is false.
        Interrupted: By a signal; the runs have saved themselves.
        RuntimeError: If runs failed; the others are shown.
        ValueError: If the configuration is not the one of the runs that are there.
    """
    first, count = config["trainer"]["seed"], config["trainer"]["num_seeds"]
    jobs = [
        Job(run_dir / f"seed-{seed}", one_seed(config, seed))
        for seed in range(first, first + count)
    ]
    with claimed(run_dir):
        present = seed_directories(run_dir)
        if (run_dir / CHECKPOINTS).exists() or (present and not resume):
            raise FileExistsError(
                f"{run_dir}: expected a directory without a run, got one that holds a run already"
            )
        for job in jobs:
            if job.path in present:
                require_same_run(saved_note(job.path).get("config") or job.config, job.config)
        write_config(config, run_dir)
        console.say(f"training {count} seeds in {run_dir}")
        how = Schema.model_validate(config)
        again = from_here("rrl", "train", f"resume={run_dir}")
        ending = launch(jobs, how.launcher, how.workers, console, again)
        done = [job.path for job in jobs if job in ending.done]
        if done:
            _show(config, find_runs(done), run_dir, console)
        require_all(ending, console)


def _show(config: assembly.Config, runs: Sequence[Run], run_dir: Path, console: Output) -> None:
    """Leave one table, curve, video and report of all seeds in their common directory."""
    group = Group(str(config["name"]), tuple(runs))
    written = show(group, group.results, run_dir, console)
    if config["render"]["enabled"]:
        most, _ = most_rescued(runs)
        of_it = {**most.config, "render": config["render"]}
        with only_said(console):
            written += film_run(of_it, most.path, run_dir, console)
    written.append(write_report(runs, run_dir / REPORT))
    for path in written:
        console.say(f"  {path}")
