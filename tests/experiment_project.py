"""A small project with a fast environment and one experiment, for the tests of `rrl reproduce`."""

import shutil
from pathlib import Path

import yaml

from rrl.trainers.experiments.outcomes import Finding
from rrl.trainers.experiments.spec import Experiment

OURS = Path(__file__).parents[1] / "configs"
TESTS = Path(__file__).parent

ENVIRONMENT = """
import os
from toy_envs import RememberingPointMass

def make(num_envs=1, seed=0, drift=0.06, dim=2):
    if os.environ.get("BROKEN_DRIFT") == str(drift):
        raise RuntimeError("the arm has come off")
    return RememberingPointMass([num_envs], seed=seed, drift=drift, dim=dim)
"""
ENV = {
    "name": "point",
    "base": {"_target_": "point.make", "drift": 0.06},
    "batching": "native",
    "max_episode_steps": 20,
    "inputs": {"end_effector_position": {}, "goal": {}},
    "scenarios": {"drifting": {}},
}
SETTINGS = {
    "scale": "tiny",
    "launcher": "local",
    "workers": 2,
    "out": "out",
    "data": None,
    "overrides": [
        "logger=[csv]",
        "render.enabled=false",
        "env=point",
        "algorithm=td3",
        "algorithm.agent.network.hidden=[16,16]",
    ],
    "scales": {
        "tiny": {
            "seeds": 2,
            "overrides": [
                "trainer.total_steps=200",
                "trainer.warmup_steps=100",
                "trainer.steps_per_collection=20",
                "trainer.batch_size=16",
                "trainer.evaluation={every: 100, episodes: 4, final_episodes: 4, slots: 4}",
                "trainer.acceptance.episodes=4",
                "trainer.checkpoint.every=100",
            ],
        }
    },
}
EXPERIMENT = {
    "title": "A point that drifts",
    "paper": "no figure",
    "figure": "sweep",
    "arms": {"residual RL": ["arm=residual"]},
    "sweep": {"key": "env.base.drift", "label": "drift [m]", "values": {"tiny": [0.0, 0.06]}},
}
SWEEP = {"key": "a.mu", "label": "mu [m]", "values": {"quick": [0.0, 1.0]}}
SPREAD = {"name": "position", "entry": "end_effector_position", "axes": ["x", "y", "z"]}
SPREAD |= {"unit": "cm", "factor": 100.0}
ZERO = {"_target_": "rrl.controllers.ZeroController"}


def write(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(content, sort_keys=False))


def write_project(folder):
    """Write environment, settings and experiment below a folder that is there."""
    (folder / "point.py").write_text(ENVIRONMENT)
    shutil.copy(TESTS / "toy_envs.py", folder)
    write(folder / "configs/env/point.yaml", ENV)
    write(folder / "configs/reproduce.yaml", SETTINGS)
    write(folder / "configs/experiment/drift.yaml", EXPERIMENT)


def finding(*outcomes):
    """An experiment of which these outcomes are all that was planned."""
    return Finding(outcomes, tuple(outcome.point for outcome in outcomes))


def of(figure, **changes):
    """An experiment that this figure shows."""
    sweep = SWEEP if figure == "sweep" else None
    changes = {"spread": SPREAD, **changes} if figure == "spread" else changes
    return Experiment(name="some", title="T", figure=figure, arms={"a": ()}, sweep=sweep, **changes)
