"""``rrl evaluate`` and ``rrl render``: play frozen episodes with a run's newest checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path

from ..configuration import build as assembly
from ..console import Output
from ..evaluation.episodes import Comparison, write_results
from ..evaluation.evaluator import Evaluator
from ..evaluation.video import choose_episode, render_comparison
from ..pretrained import best_run, trained_run
from ..report.runs import Group, find_runs
from ..report.tables import one_run, terminal_tables
from ..seeds import Stream, first_seed
from ..storage.run_files import VIDEOS, seed_directories
from ..training.progress import Progress
from ..training.run_policy import RunPolicy

__all__ = ["evaluate", "film", "film_run", "render"]

Comparisons = Mapping[str, Comparison]
"""Scenario to its comparison with the controller."""


def evaluate(config: assembly.Config, run_dir: Path, console: Output) -> None:
    """Evaluate the newest checkpoint of a run, or of every seed, on every scenario."""
    for path in seed_directories(run_dir) or [run_dir]:
        results, _ = _evaluate(config, path, console)
        declared = Group("", tuple(find_runs([path]))).declared
        title = f"{config['name']} ({path})"
        console.print(terminal_tables(one_run(results), declared, title=title))
        time = datetime.now(timezone.utc).strftime("%Y-%m-%d_%H-%M-%S")
        write_results(results, path / f"evaluation-{time}.json")
        console.say(f"  {path / f'evaluation-{time}.json'}")


def render(config: assembly.Config, run_dir: Path, console: Output) -> None:
    """Write a video of controller and residual on the same episode."""
    for path in film_run(config, best_run(run_dir), run_dir, console):
        console.say(f"  {path}")


def film_run(config: assembly.Config, run: Path, out: Path, console: Output) -> list[Path]:
    """Film an episode of a run into ``out``; the run is evaluated if that has to be chosen."""
    if isinstance(config["render"]["episode"], int):
        _, handed_over = _load(config, run, console)
        return film(config, handed_over, {}, out, console)
    results, handed_over = _evaluate(config, run, console)
    return film(config, handed_over, results, out, console)


def _evaluate(
    config: assembly.Config, run_dir: Path, console: Output
) -> tuple[Comparisons, RunPolicy]:
    settings = assembly.settings(config)
    env_steps, handed_over = _load(config, run_dir, console)
    evaluator = Evaluator(assembly.scenarios(config), settings.evaluation)
    results = {}
    for scenario in Progress(console).track(evaluator.scenarios, "evaluating"):
        results[scenario] = handed_over.compare(
            evaluator,
            env_steps,
            scenario,
            Stream.FINAL,
            settings.evaluation.final_episodes,
        )
    evaluator.close()
    return results, handed_over


def _load(config: assembly.Config, run_dir: Path, console: Output) -> tuple[int, RunPolicy]:
    """Return what a run hands over, and the environment steps of the checkpoint that has it."""
    config = {**config, "trainer": {**config["trainer"], "num_seeds": 1}}
    assembly.check(config)
    trained = trained_run(config, run_dir)
    console.say(f"loaded {trained.checkpoint}")
    return trained.env_steps, trained.handed_over


def film(
    config: assembly.Config,
    handed_over: RunPolicy,
    results: Comparisons,
    run_dir: Path,
    console: Output,
) -> list[Path]:
    """Film an episode of what is handed over; the list is empty where nothing can be rendered.

    ``results`` are needed only to choose the episode, not where it has a number.
    """
    settings, render = assembly.settings(config), config["render"]
    scenarios = assembly.scenarios(config)
    node, scenario = config["env"].get("renderer"), render["scenario"] or next(iter(scenarios))
    if not node:
        return []
    if scenario not in scenarios:
        raise ValueError(f"render.scenario: expected one of {sorted(scenarios)}, got {scenario!r}")
    if handed_over.tested and not handed_over.env_steps:
        console.say("the run hands over the controller: both halves of the video show it")
    rescued = results[scenario].handed_over.rescues.tolist() if scenario in results else []
    count = settings.evaluation.final_episodes
    episode = choose_episode(render["episode"], count, rescued)
    out = run_dir / VIDEOS / f"{scenario}_episode_{episode}.{render['format']}"
    try:
        film = render_comparison(
            scenarios[scenario],
            handed_over.policy,
            assembly.build(node),
            first_seed(Stream.FINAL, settings.evaluation.seed) + episode,
            out,
            render,
        )
    except RuntimeError as error:
        console.say(f"no video: {error}", style="yellow")
        return []
    return [film]
