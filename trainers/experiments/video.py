"""A video of an episode that the controller fails and the residual solves."""

from __future__ import annotations

from pathlib import Path

from ..console import Output
from ..launch.launchers import spawn
from ..report.runs import Run
from .outcomes import Findings

__all__ = ["rescue_video"]


def rescue_video(findings: Findings, console: Output) -> Path | None:
    """Return the video of the run with the most rescued episodes; ``rrl render`` makes it.

    Returns:
        None if no run has rescued an episode, or the machine cannot render.
    """
    rescues: dict[Run, float] = {
        run: run.summary()["rescues"]
        for finding in findings.values()
        for outcome in finding.outcomes
        if outcome.knows("rescues") and not outcome.acts_alone
        for run in outcome.runs
        if run.config["env"].get("renderer")
    }
    if not any(rescues.values()):
        return None
    run = max(rescues, key=lambda run: rescues[run])
    if not run.videos:
        console.say(f"rendering an episode of {run.label}")
        spawn(["render", f"run={run.path}"], run.path / "render.txt").wait()
    if not run.videos:
        console.say(f"no video: see {run.path / 'render.txt'}", style="yellow")
        return None
    return run.videos[0]
