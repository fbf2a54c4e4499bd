"""A video of an episode that the controller fails and the residual solves, from the runs of an experiment."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from ..launch.launchers import spawn
from ..report.runs import Run
from .outcomes import Findings

EPISODES = 25
"""Of the frozen ones, searched for such an episode."""


def rescue_video(findings: Findings, console: Console) -> Path | None:
    """The video of the run with the most rescued episodes; made by ``rrl render`` if it is not there.

    Returns:
        None if no run has rescued an episode, or the machine cannot render.
    """
    best = _most_rescues(findings)
    if best is None:
        return None
    run = best
    if not run.videos:
        console.print(f"rendering an episode of {run.label}", highlight=False, soft_wrap=True)
        command = ["render", f"run={run.path}", "render.enabled=true"]
        spawn(
            [*command, f"trainer.evaluation.final_episodes={EPISODES}"], run.path / "render.txt"
        ).wait()
    if not run.videos:
        console.print(
            f"no video: see {run.path / 'render.txt'}",
            style="yellow",
            highlight=False,
            soft_wrap=True,
        )
        return None
    return run.videos[0]


def _most_rescues(findings: Findings) -> Run | None:
    best, most = None, 0.0
    for finding in findings.values():
        for outcome in finding.outcomes:
            for run in outcome.runs if outcome.knows("rescues") and not outcome.acts_alone else ():
                rescues = run.results[run.followed]["summary"]["rescues"]
                if run.config["env"].get("renderer") and rescues > most:
                    best, most = run, rescues
    return best
