"""Videos of what runs learned: of one rescued episode, and of every task."""

from __future__ import annotations

from pathlib import Path

from ..console import Output
from ..launch.launchers import spawn
from ..report.runs import Run
from ..report.tables import most_rescued
from ..storage.run_files import CHECKPOINTS
from .outcomes import Finding, Findings

Video = tuple[Path, str]
"""A video and what it shows."""


def rescue_video(findings: Findings, console: Output) -> Path | None:
    """Return the video of the run with the most rescued episodes; ``rrl render`` makes it.

    Returns:
        None if no run has rescued an episode, or the machine cannot render.
    """
    runs = [
        run
        for finding in findings.values()
        for outcome in finding.outcomes
        if outcome.knows("rescues") and not outcome.acts_alone
        for run in outcome.runs
        if run.config["env"].get("renderer")
    ]
    run, episodes = most_rescued(runs) if runs else (None, [])
    return _rendered(run, episodes[0], console) if run and episodes else None


def task_videos(finding: Finding, console: Output) -> list[Video]:
    """Return a video of every arm: what the run that rescues the most hands over, and where."""
    videos = []
    for outcome in finding.outcomes:
        if outcome.point.config["env"].get("renderer"):
            run, episodes = most_rescued(outcome.runs)
            episode = next(iter(episodes), 0)
            if video := _rendered(run, episode, console):
                caption = f"{outcome.point.label}: seed {run.seed}, episode {episode}."
                videos.append((video, caption))
    return videos


def _rendered(run: Run, episode: int, console: Output) -> Path | None:
    """Return the video of an episode; it is made where the run still has what it learned."""
    if (video := _video(run, episode)) or not (run.path / CHECKPOINTS).is_dir():
        return video
    console.say(f"rendering an episode of {run.label}")
    log = run.path / "render.txt"
    chosen = [f"render.scenario={run.followed}", f"render.episode={episode}"]
    spawn(["render", f"run={run.path}", *chosen], log).wait()
    video = _video(run, episode)
    if video is None:
        console.say(f"no video: see {log}", style="yellow")
    return video


def _video(run: Run, episode: int) -> Path | None:
    name = f"{run.followed}_episode_{episode}"
    return next((path for path in run.videos if path.stem == name), None)
