"""``rrl train`` of one seed in this process, with what it leaves behind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..configuration import build as assembly
from ..console import Output, from_here
from ..evaluation.episodes import write_results
from ..launch.job import Job, write_config
from ..pretrained import start_from
from ..report.notes import Results
from ..report.report import write_report
from ..report.runs import Group, find_runs
from ..report.tables import (
    COLUMNS,
    EPISODE_COLUMNS,
    episode_rows,
    one_run,
    success_rows,
)
from ..storage.checkpoints import saved_note
from ..storage.run_files import REPORT, RESULTS, seed_directories
from ..storage.same_run import require_same_run
from ..storage.versions import write_versions
from ..training.progress import Progress
from ..training.trainer import Trainer
from .evaluate import film, only_said, show
from .seeds import train_seeds

MEDIA = (".png", ".mp4", ".gif")


def train(config: assembly.Config, run_dir: Path, console: Output, *, resume: bool) -> None:
    """Train one seed here or several in a pool; leave table, curve, video and report."""
    seeds = seed_directories(run_dir)  # of those that are there each is checked by itself
    assembly.check(config, training=True, new=not (seeds or saved_note(run_dir)))
    if config["trainer"]["num_seeds"] > 1 or seeds:
        train_seeds(config, run_dir, console, resume=resume)
        return
    if resume:
        require_same_run(saved_note(run_dir).get("config") or config, config)
    trainer = assembly.trainer(config, run_dir, Progress(console), checked=True)
    try:
        if not (resume and _resume(trainer, console)):
            start_from(trainer.agent, config)
        trainer.require_new_or_resumed()
        try:
            _train(config, trainer, console)
        except Exception:
            if trainer.env_steps:
                command = from_here("rrl", "train", f"resume={run_dir}")
                console.say(f"the run is on disk; to go on with it:\n  {command}")
            raise
    finally:
        trainer.close()


def _resume(trainer: Trainer, console: Output) -> bool:
    """Return whether there was a checkpoint to go on from."""
    try:
        console.say(f"resuming from {trainer.resume()}")
        return True
    except FileNotFoundError:
        if trainer.store.log.count:
            raise
        console.say("no checkpoint yet: starting from the beginning")
        return False


def _train(config: assembly.Config, trainer: Trainer, console: Output) -> None:
    run_dir = trainer.run_dir
    if not Job(run_dir, config).finished:
        (run_dir / RESULTS).unlink(missing_ok=True)  # it marks a finished run
    write_config(config, run_dir)
    write_versions(run_dir, config["env"].get("packages") or ())
    results = trainer.run()
    if trainer.settings.profile:
        console.print(trainer.profile.table())
    records = {scenario: comparison.record() for scenario, comparison in results.items()}
    runs = [replace(run, ended=records) for run in find_runs([run_dir])]
    group, shown = Group(str(config["name"]), tuple(runs)), one_run(results)
    written = show(group, shown, run_dir, console)
    if config["render"]["enabled"]:
        with only_said(console):
            written += film(config, trainer.acceptance.handed_over, records, run_dir, console)
    _log_results(trainer, shown, [path for path in written if path.suffix in MEDIA])
    written.append(write_report(runs, run_dir / REPORT))
    write_results(results, run_dir / RESULTS)  # last: it marks a finished run
    for path in written:
        console.say(f"  {path}")


def _log_results(trainer: Trainer, results: Results, media: Sequence[Path]) -> None:
    """Give the loggers what a metric cannot say: pictures, videos, table and paired episodes."""
    steps = trainer.env_steps
    for logger in trainer.loggers:
        for path in media:
            name = path.stem if path.suffix == ".png" else "video"
            logger.log_file(f"media/{name}", path, steps)
        logger.log_table("results/success", COLUMNS, success_rows(results), steps)
        logger.log_table("results/episodes", EPISODE_COLUMNS, episode_rows(results), steps)
