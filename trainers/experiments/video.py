"""Videos of what runs learned: of one rescued episode, and of every task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..console import Output
from ..launch.launchers import spawn
from ..report.runs import Run
from ..report.tables import handed_over
from ..storage.run_files import CHECKPOINTS
from .outcomes import Finding, Findings, Outcome

__all__ = ["rescue_video", "task_videos"]

Video = tuple[Path, str]
"""A video and what it shows."""


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
    return _rendered(max(rescues, key=lambda run: rescues[run]), "rescue", console)


def task_videos(finding: Finding, console: Output) -> list[Video]:
    """Return a video of every arm: what the run that rescues the most hands over, and where."""
    videos = []
    for outcome in finding.outcomes:
        if outcome.point.config["env"].get("renderer"):
            run, episode = _most_rescued(outcome)
            if video := _rendered(run, episode, console):
                videos.append((video, f"{outcome.point.arm}: seed {run.seed}, episode {episode}."))
    return videos


def _most_rescued(outcome: Outcome) -> tuple[Run, int]:
    """Return the run that rescues the most final episodes, and the first of them; or the first."""
    found = {
        run: _rescued(handed_over(run.results[run.followed])["episodes"]) for run in outcome.runs
    }
    run = max(found, key=lambda run: len(found[run]))
    return run, next(iter(found[run]), 0)


def _rescued(episodes: Mapping[str, Sequence[Any]]) -> list[int]:
    pairs = zip(episodes.get("controller_success", ()), episodes.get("success", ()), strict=True)
    return [i for i, (alone, helped) in enumerate(pairs) if helped and not alone]


def _rendered(run: Run, episode: str | int, console: Output) -> Path | None:
    if not run.videos and not (run.path / CHECKPOINTS).is_dir():
        return None  # it is kept without what it learned
    if not run.videos:
        console.say(f"rendering an episode of {run.label}")
        log = run.path / "render.txt"
        spawn(["render", f"run={run.path}", f"render.episode={episode}"], log).wait()
    if not run.videos:
        console.say(f"no video: see {run.path / 'render.txt'}", style="yellow")
        return None
    return run.videos[0]
