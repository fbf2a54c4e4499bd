"""``rrl export``: what a robot needs of a run, in one folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ..configuration import build as assembly
from ..console import Output
from ..export.folder import export_policy, require_tools
from ..pretrained import TrainedRun, best_run
from ..report.runs import Run
from ..storage.run_files import EXPORT
from .evaluate import load


def export(config: assembly.Config, run_dir: Path, console: Output) -> None:
    """Write the policy of a run, or of the best seed, with everything around it."""
    require_tools()  # before the run is loaded, which takes a while
    run, folder = best_run(run_dir), run_dir / EXPORT
    trained = load(config, run, console)
    handed_over = trained.handed_over
    if trained.checkpoint and handed_over.tested and not handed_over.env_steps:
        console.say("no policy was accepted: the folder holds the controller alone")
    environment = replace(
        assembly.environment(config), control_period=assembly.control_period(config)
    )
    content = export_policy(environment, handed_over.policy, folder, _about(config, run, trained))
    for line in _summary(content):
        console.say(line)
    for path in sorted(folder.iterdir()):
        console.say(f"  {path}")


def _about(config: assembly.Config, run: Path, trained: TrainedRun) -> dict[str, Any]:
    """Return where a policy was trained and how well it did."""
    found, handed_over = Run(run, run.name), trained.handed_over
    return {
        "trained": {
            "name": config["name"],
            "run": str(run),
            "checkpoint": trained.checkpoint and trained.checkpoint.name,
            "accepted_env_steps": handed_over.env_steps if handed_over.tested else None,
            "environment": config["env"]["base"],
            "algorithm": config["algorithm"]["agent"],
            "seed": found.seed,
            "versions": found.versions,
        },
        "results": {scenario: record["summary"] for scenario, record in found.results.items()},
    }


def _summary(content: dict[str, Any]) -> list[str]:
    """Return what to know before a robot gets it."""
    period, controller = content["control_period"], content["controller"]
    rate = f"{1 / period:g} Hz" if period else "an unknown rate (env.control_period=SECONDS)"
    lines = [
        f"reads {_arrays(content['entries'])} at {rate}; commands {_arrays([content['command']])}",
        f"remembers {_arrays(content['state']) or 'nothing'}",
    ]
    outside = f"stays outside, and base_action is an entry: {controller['why_outside']}"
    where = "is inside" if controller["why_outside"] is None else outside
    lines.append(f"the controller {controller['class']} {where}")
    simulated = [node["class"] for group in content["left_out"].values() for node in group]
    lines += [f"left out, because a robot has its own: {', '.join(simulated)}"] if simulated else []
    rehearsal = content["rehearsal"]
    worst = max(rehearsal["largest_difference"].values())
    lines.append(
        f"the trainer's commands to {worst:.1e} of the half range, in {rehearsal['steps']} steps"
    )
    return lines


def _arrays(nodes: list[dict[str, Any]]) -> str:
    return ", ".join(f"{node['name']} {node['shape']}" for node in nodes)
