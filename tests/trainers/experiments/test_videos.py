"""A video shows the episode that its caption names."""

import io

from experiment_project import finding
from rrl.trainers.console import Output
from rrl.trainers.experiments.video import rescue_video, task_videos

SOLVED = {"controller_success": [0, 1, 0, 0], "success": [0, 1, 0, 1]}
"""Episode 3 is rescued."""


def test_the_episode_that_is_named_is_taken(outcome):
    made = outcome()
    for run in made.runs:
        run.config["env"]["renderer"] = {"camera": "front"}
        run.results["misaligned"]["episodes"] |= {"controller_success": [0], "success": [0]}
    run = made.runs[1]
    run.results["misaligned"]["episodes"] |= SOLVED
    videos = run.path / "videos"
    videos.mkdir()
    (videos / "misaligned_episode_12.mp4").touch()
    console = Output(file=io.StringIO())
    assert rescue_video({"some": finding(made)}, console) is None  # nothing is left to render from
    assert task_videos(finding(made), console) == []
    (videos / "misaligned_episode_3.mp4").touch()
    assert rescue_video({"some": finding(made)}, console) == videos / "misaligned_episode_3.mp4"
    ((video, caption),) = task_videos(finding(made), console)
    assert video.name == "misaligned_episode_3.mp4"
    assert caption == "residual RL: seed 1, episode 3."
