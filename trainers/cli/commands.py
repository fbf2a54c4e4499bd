"""What the commands do with a resolved configuration: train, evaluate, render."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from ..configuration import build as assembly
from ..evaluation.episodes import Comparison, write_results
from ..evaluation.evaluator import Evaluator
from ..evaluation.video import choose_episode, render_comparison
from ..pretrained import start_from, trained_agent
from ..report.learning_curve import learning_curve
from ..report.report import write_report
from ..report.runs import Group, find_runs, group_runs
from ..report.tables import (
    COLUMNS,
    EPISODE_COLUMNS,
    Results,
    episode_rows,
    markdown_tables,
    one_run,
    success_rows,
    terminal_tables,
)
from ..seeds import Stream, first_seed
from ..storage.checkpoints import saved_config
from ..storage.files import write_atomically
from ..storage.run_files import CONFIG_FILE, METRICS, REPORT, RESULTS, VIDEOS
from ..storage.same_run import require_same_run
from ..storage.versions import write_versions
from ..training.progress import Progress
from ..training.trainer import Trainer

VIDEO, VIDEO_FILES = "video", (".mp4", ".gif")
MEDIA = (".png", *VIDEO_FILES)
Comparisons = Mapping[str, Comparison]
"""Scenario to its comparison with the controller."""


def train(config: assembly.Config, run_dir: Path, console: Console, *, resume: bool) -> None:
    """Train, then leave a table, a learning curve and a video in the run's directory."""
    if resume:
        require_same_run(saved_config(run_dir) or config, config)
    trainer = assembly.trainer(config, run_dir, Progress(console))
    try:
        if not (resume and _resume(trainer, console)):
            start_from(trainer.agent, config)
        trainer.require_new_or_resumed()
        write_atomically(run_dir / CONFIG_FILE, yaml.safe_dump(dict(config), sort_keys=False))
        write_versions(run_dir)
        results = trainer.run()
        if trainer.settings.profile:
            console.print(trainer.profile.table())
        _report(config, trainer, results, console)
    except Exception:
        command = f"rrl train resume={shlex.quote(str(run_dir))}"
        console.print(
            f"the run is on disk; to go on with it:\n  {command}", highlight=False, soft_wrap=True
        )
        raise
    finally:
        trainer.close()


def _resume(trainer: Trainer, console: Console) -> bool:
    """Whether there was a checkpoint to go on from."""
    try:
        console.print(f"resuming from {trainer.resume()}", highlight=False)
        return True
    except FileNotFoundError:
        if trainer.store.log.count:
            raise
        console.print(
            "the run was stopped before its first checkpoint: starting from the beginning",
            highlight=False,
        )
        return False


def _report(
    config: assembly.Config, trainer: Trainer, results: Comparisons, console: Console
) -> None:
    run_dir = trainer.run_dir
    (group,) = group_runs(find_runs([run_dir]))
    shown = one_run(results)
    console.print(terminal_tables(shown, group.units, title=str(config["name"])))
    written = [run_dir / "results.md", run_dir / CONFIG_FILE]
    write_atomically(written[0], markdown_tables(shown, group.units))
    scenario = next(iter(results))
    if trainer.env_steps and (run_dir / METRICS).exists():
        curve = learning_curve(group, run_dir / "learning_curve.png")
        written += [curve] if curve else []
    video = _video(config, trainer.agent, results, scenario, run_dir, console)
    written += [video] if video else []
    write_results(results, run_dir / RESULTS)
    written.append(write_report(find_runs([run_dir]), run_dir / REPORT))
    for path in written:
        console.print(f"  {path}", highlight=False, soft_wrap=True)
    _log_results(trainer, shown, [path for path in written if path.suffix in MEDIA])


def _log_results(trainer: Trainer, results: Results, media: Sequence[Path]) -> None:
    """Give the loggers what a metric cannot say: pictures, videos, the table and every paired episode."""
    steps = trainer.env_steps
    for logger in trainer.loggers:
        for path in media:
            logger.log_file(
                f"media/{VIDEO if path.suffix in VIDEO_FILES else path.stem}", path, steps
            )
        logger.log_table("results/success", COLUMNS, success_rows(results), steps)
        logger.log_table("results/episodes", EPISODE_COLUMNS, episode_rows(results), steps)


def evaluate(config: assembly.Config, run_dir: Path, console: Console) -> None:
    """Evaluate a run's newest checkpoint on every scenario of the configuration."""
    results, _ = _evaluate(config, run_dir, console)
    write_results(results, run_dir / f"evaluation-{datetime.now(timezone.utc):%Y%m%dT%H%M%SZ}.json")
    units = Group("", tuple(find_runs([run_dir]))).units
    console.print(terminal_tables(one_run(results), units, title=f"{config['name']} ({run_dir})"))


def render(config: assembly.Config, run_dir: Path, console: Console) -> None:
    """Write a video of controller and residual on the same episode."""
    results, agent = _evaluate(config, run_dir, console)
    scenario = config["render"]["scenario"] or next(iter(results))
    if scenario not in results:
        raise ValueError(f"render.scenario: expected one of {sorted(results)}, got {scenario!r}")
    path = _video(config, agent, results, scenario, run_dir, console)
    if path:
        console.print(f"  {path}", highlight=False, soft_wrap=True)


def _evaluate(config: assembly.Config, run_dir: Path, console: Console) -> tuple[Comparisons, Any]:
    assembly.check(config)
    settings = assembly.settings(config)
    agent, path = trained_agent(config, run_dir)
    console.print(f"loaded {path}", highlight=False, soft_wrap=True)
    evaluator = Evaluator(assembly.scenarios(config), settings.evaluation)
    results = {
        scenario: evaluator.compare(
            agent.policy_of(0), scenario, Stream.FINAL, settings.evaluation.final_episodes
        )
        for scenario in Progress(console).track(evaluator.scenarios, "evaluating")
    }
    evaluator.close()
    return results, agent


def _video(
    config: assembly.Config,
    agent: Any,
    results: Comparisons,
    scenario: str,
    run_dir: Path,
    console: Console,
) -> Path | None:
    settings, render = assembly.settings(config), config["render"]
    node = config["env"].get("renderer")
    if not render["enabled"] or not node:
        return None
    k = render["seed"]
    if not 0 <= k < settings.num_seeds:
        raise ValueError(
            f"render.seed: expected a number below num_seeds ({settings.num_seeds}), got {k}"
        )
    episode = choose_episode(results[scenario], render["episode"])
    try:
        return render_comparison(
            assembly.scenarios(config)[scenario],
            agent.policy_of(k),
            assembly.build(node),
            first_seed(Stream.FINAL, settings.evaluation.seed) + episode,
            run_dir / VIDEOS / f"{scenario}_episode_{episode}.{render['format']}",
            render,
        )
    except RuntimeError as error:
        console.print(f"no video: {error}", style="yellow", highlight=False)
        return None
