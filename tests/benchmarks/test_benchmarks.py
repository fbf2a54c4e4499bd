"""Benchmarks fit today's code: contenders, the exported policy beside the trainer's chain."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NEEDS = {"sb3": "stable_baselines3", "sb3-several": "stable_baselines3", "sbx": "sbx"}


@pytest.mark.slow
def test_an_exported_policy_is_measured_beside_the_trainers_chain():
    options = ["--rates", "50", "--seconds", "0.2", "--episodes", "1"]
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.deploy", *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line.split("|")[1].strip() for line in done.stdout.splitlines() if line]
    assert [row for row in rows if row == "50 Hz"] == ["50 Hz"] * 3
    assert rows.count("policy.onnx") == 2


@pytest.mark.slow
def test_the_controller_is_tuned_by_every_method_for_every_goal():
    for package in ("optuna", "cmaes"):
        pytest.importorskip(package)
    options = ["--episodes", "24", "--seeds", "1"]
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.tuning", *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = [line for line in done.stdout.splitlines() if line.startswith(("| 0 |", "| 24 |"))]
    assert len(rows) == 1 + 2 * 2
    assert all(row.endswith(" % |") for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rrl", "rrl-plain", "rrl-default", "cleanrl", "torchrl", *NEEDS])
def test_a_contender_trains(name):
    pytest.importorskip(NEEDS.get(name, "rrl"))
    settings = ["trainer.total_steps=500", "trainer.warmup_steps=100"]
    command = [sys.executable, "-W", "ignore", "-m", "benchmarks.speed.contenders", name, *settings]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout.splitlines()[-1])
    assert measured["steps_per_second"] > 0
