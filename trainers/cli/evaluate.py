"""``rrl evaluate`` and ``rrl render``: play frozen episodes again, as a run ended or was left."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime, timezone
from functools import partial
from pathlib import Path

import yaml

from ..configuration import build as assembly
from ..console import Output
from ..errors import place
from ..evaluation.episodes import Comparison, write_results
from ..evaluation.evaluator import Evaluator
from ..evaluation.video import render_comparison
from ..launch.job import Job, one_seed
from ..pretrained import TrainedRun, best_run, trained_run
from ..report.learning_curve import learning_curve
from ..report.runs import Group, Record, Run, declared_in
from ..report.tables import (
    Results,
    handed_over,
    markdown_tables,
    one_run,
    rescued,
    terminal_tables,
)
from ..seeds import Stream, first_seed
from ..storage.files import write_atomically
from ..storage.run_files import CONFIG_FILE, VIDEOS, seed_directories
from ..training.progress import Progress
from ..training.run_policy import RunPolicy


def show(group: Group, results: Results, run_dir: Path, console: Output) -> list[Path]:
    """Print the tables, and leave them and the learning curve in ``run_dir``.

    Returns:
        What lies there now, the configuration too.
    """
    console.print(terminal_tables(results, group.declared, title=group.label))
    table = run_dir / "results.md"
    write_atomically(table, markdown_tables(results, group.declared))
    written, learned = [table, run_dir / CONFIG_FILE], any(run.env_steps for run in group.runs)
    if learned and (curve := learning_curve(group, run_dir / "learning_curve.png")):
        written.append(curve)
    return written


def evaluate(config: assembly.Config, run_dir: Path, console: Output) -> None:
    """Evaluate a run again, or every seed of one, on every scenario."""
    declared = declared_in(config)
    for path in seed_directories(run_dir) or [run_dir]:
        results = _evaluate(config, load(config, path, console), console)
        title = f"{config['name']} ({path})"
        console.print(terminal_tables(one_run(results), declared, title=title))
        time = datetime.now(timezone.utc).strftime("%Y-%m-%d_%H-%M-%S-%f")
        out = path / f"evaluation-{time}.json"
        write_atomically(out.with_suffix(".yaml"), yaml.safe_dump(dict(config), sort_keys=False))
        write_results(results, out)
        console.say(f"  {out}")


def render(config: assembly.Config, run_dir: Path, console: Output) -> None:
    """Write a video of controller and residual on the same episode.

    Raises:
        ValueError: If the environment has no renderer.
    """
    if not config["env"].get("renderer"):
        raise ValueError(
            "env.renderer: expected what makes a video's frames, got null: see "
            "rrl.envs.render_states and rrl.envs.render_mujoco"
        )
    for path in film_run(config, best_run(run_dir), run_dir, console):
        console.say(f"  {path}")


def load(config: assembly.Config, run_dir: Path, console: Output) -> TrainedRun:
    """Check the configuration, return what a run's newest checkpoint holds, and say so.

    Raises:
        ValueError: If the configuration is wrong.
        FileNotFoundError: See :func:`trained_run`.
    """
    assembly.check(config)
    trained = trained_run(config, run_dir)
    if trained.checkpoint is None:
        console.say("nothing was trained: it is the controller alone")
    else:
        console.say(f"loaded {trained.checkpoint}")
    return trained


def film_run(config: assembly.Config, run: Path, out: Path, console: Output) -> list[Path]:
    """Film an episode of a run into ``out``.

    The run is evaluated if the episode has to be chosen and no evaluation like that is there.
    """
    trained, found = load(config, run, console), Run(run, run.name)
    records: Mapping[str, Record] = found.results
    numbered = isinstance(config["render"]["episode"], int)
    if not numbered and not Job(run, one_seed(config, found.seed)).finished:
        comparisons = _evaluate(config, trained, console)
        records = {scenario: comparison.record() for scenario, comparison in comparisons.items()}
    return film(config, trained.handed_over, records, out, console)


def _evaluate(
    config: assembly.Config, trained: TrainedRun, console: Output
) -> dict[str, Comparison]:
    """Return the run's comparison with the controller in every scenario."""
    settings = assembly.settings(config).evaluation
    evaluator = Evaluator(assembly.scenarios(config), settings)
    compare = partial(trained.handed_over.compare, evaluator, trained.env_steps)
    results = {
        scenario: compare(scenario, Stream.FINAL, settings.final_episodes)
        for scenario in Progress(console).track(evaluator.scenarios, "evaluating")
    }
    evaluator.close()
    return results


@contextmanager
def only_said(console: Output) -> Iterator[None]:
    """Have a video that fails say so, and cost nothing of what comes after it."""
    try:
        yield
    except Exception as error:  # whatever a renderer, a codec or a driver can come up with
        console.say(f"no video: {error}{place(error)}", style="yellow")


def film(
    config: assembly.Config,
    shown: RunPolicy,
    records: Mapping[str, Record],
    run_dir: Path,
    console: Output,
) -> list[Path]:
    """Film an episode of what a run hands over; without a renderer say so, and film nothing.

    Args:
        config: The resolved configuration, checked.
        shown: What the run hands over.
        records: Of the final evaluation; not needed where the episode has a number.
        run_dir: Where the video goes, into ``videos``.
        console: Where to say what the video shows.

    Raises:
        RuntimeError: If this machine cannot render.
    """
    scenarios, how = assembly.scenarios(config), config["render"]
    node, scenario = config["env"].get("renderer"), how["scenario"] or next(iter(scenarios))
    if not node:
        console.say("no video: env.renderer is not set")
        return []
    if shown.tested and not shown.env_steps:
        console.say("the run hands over the controller: both halves of the video show it")
    found = rescued(handed_over(records[scenario])) if scenario in records else []
    episode = next(iter(found), 0) if how["episode"] == "rescue" else how["episode"]
    out = run_dir / VIDEOS / f"{scenario}_episode_{episode}.{how['format']}"
    seed = first_seed(Stream.FINAL, assembly.settings(config).evaluation.seed) + episode
    renderer = assembly.build(node)
    return [render_comparison(scenarios[scenario], shown.policy, renderer, seed, out, how)]
