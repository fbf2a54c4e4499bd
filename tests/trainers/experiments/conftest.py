"""A project of its own with a fast environment and a small experiment."""

import csv
import json
import sys
from dataclasses import replace
from functools import partial

import pytest
import yaml

from experiment_project import SPREAD, write_project
from rrl.trainers.cli.compose import compose as compose_config
from rrl.trainers.console import Output
from rrl.trainers.experiments.outcomes import Outcome
from rrl.trainers.experiments.plan import Point
from rrl.trainers.experiments.reproduce import reproduce
from rrl.trainers.experiments.spec import Spread, load_experiments
from rrl.trainers.report.runs import Run

SEEDS = (0, 1, 2)
EPISODES = 20


@pytest.fixture
def project(tmp_path, monkeypatch):
    """The project's folder, which is the working directory; write experiments with :func:`write`."""
    write_project(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "point", raising=False)  # another test's project has one too
    yield tmp_path
    sys.modules.pop("point", None)  # an example has one too


@pytest.fixture
def folders(project):
    return [project / "configs"]


@pytest.fixture
def compose(project):
    return partial(compose_config, folder=project / "configs")


@pytest.fixture
def run(project, folders, compose):
    """``rrl reproduce`` in this process, its runs in processes of their own; returns the report and what was said."""

    def call(*names, **changes):
        with (project / "said.txt").open("w") as file:
            again = " ".join(["rrl reproduce", *names])
            report = reproduce(names, changes, compose, folders, Output(file=file), again)
        return report, (project / "said.txt").read_text()

    return call


@pytest.fixture
def experiments(folders):
    return lambda *names: load_experiments(names, folders)


@pytest.fixture
def outcome(tmp_path):
    """Makes an outcome from final numbers by entry and curves by entry, spread a little over the seeds."""

    def make(
        arm="residual RL", value=None, curves=None, scenario="misaligned", scenarios=None, **final
    ):
        scenarios = scenarios or {scenario: {}}
        runs = tuple(write(arm, curves, scenarios, final, seed) for seed in SEEDS)
        point = Point("some", arm, value, "key", (), runs[0].config, SEEDS, swept="mu")
        point = replace(point, spread=Spread(**SPREAD))
        return Outcome(point, runs)

    def episodes(summary):
        rates = {k: v for k, v in summary.items() if k in ("success", "controller_success")}
        solved = {
            k: [i < round(rate * EPISODES) for i in range(EPISODES)] for k, rate in rates.items()
        }
        return {"return": [0.0] * EPISODES, **solved}

    def write(arm, curves, scenarios, final, seed):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        path.mkdir()
        numbers = {"success": 1.0, "return": -2.0, "controller_success": 0.1}
        numbers |= {"controller_return": -4.0, **final}
        numbers["return"] += 0.001 * seed
        numbers = {"return_gain": numbers["return"] - numbers["controller_return"], **numbers}
        numbers = {"rescues": 5, "regressions": 0, "mcnemar_p": 0.06, **numbers}
        results = {
            name: {"summary": {**numbers, **entry}, "episodes": episodes({**numbers, **entry})}
            for name, entry in scenarios.items()
        }
        (path / "results.json").write_text(json.dumps(results))
        curves = {"success": [0, 1], "return": [-4, -2], **(curves or {})}
        curves |= {f"controller_{name}": [v[0]] * len(v) for name, v in curves.items()}
        with (path / "metrics.csv").open("w") as file:
            rows = csv.writer(file)
            rows.writerow(["env_steps", "metric", "value"])
            followed = f"eval/{next(iter(results))}"
            for name, values in curves.items():
                spread = 0.0 if name.endswith("success") else 0.01 * seed
                rows.writerows(
                    [i * 500, f"{followed}/{name}", v + spread] for i, v in enumerate(values)
                )
        trainer = {"seed": seed, "num_seeds": 1, "total_steps": 500}
        trainer["evaluation"] = {"episodes": EPISODES, "final_episodes": EPISODES}
        config = {"trainer": trainer, "env": {"scenarios": {name: {} for name in results}}}
        config["controller"] = {"_target_": "rrl.controllers.ProportionalController"}
        (path / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
        (path / "versions.json").write_text(json.dumps({"torch": "2.0"}))
        return Run(path, path.name)

    return make
