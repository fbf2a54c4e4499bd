"""Success against a quantity that shall stay small: drawn, tabulated, and refused where there is no such quantity."""

import csv

import pytest
import yaml

from experiment_project import write
from rrl.trainers.experiments.plan import plan_points
from rrl.trainers.experiments.spec import load_experiments, load_settings

DRIVEN = """
import torch
from torchrl.data import Composite, Unbounded

class Driven(RememberingPointMass):
    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        effort = Unbounded((*self.batch_size, 1))
        self.observation_spec["metrics"] = Composite(effort=effort, shape=self.batch_size)

    def _reset(self, tensordict=None, **kwargs):
        out = super()._reset(tensordict, **kwargs)
        return out.set("metrics", {"effort": torch.zeros(*self.batch_size, 1)})

    def _step(self, tensordict):
        effort = tensordict["action"].norm(dim=-1, keepdim=True)
        return super()._step(tensordict).set("metrics", {"effort": effort})

def make_driven(num_envs=1, seed=0, drift=0.06):
    return Driven([num_envs], seed=seed, drift=drift)
"""
ARMS = {"free": [], "half": ["residual_scale=0.25"]}
FRONT = {"title": "Success against effort", "figure": "front", "metric": "effort", "arms": ARMS}


@pytest.fixture
def driven(project):
    """The project with an environment that reports its effort, in newtons and with a limit."""
    with (project / "point.py").open("a") as file:
        file.write(DRIVEN)
    path = project / "configs/env/point.yaml"
    env = yaml.safe_load(path.read_text())
    env["base"]["_target_"] = "point.make_driven"
    write(path, {**env, "metrics": {"effort": {"unit": "N", "reduce": "max", "limit": 0.5}}})
    write(project / "configs/experiment/front.yaml", FRONT)
    return project


@pytest.mark.slow
def test_a_front_shows_every_arm_and_the_controller(driven, run):
    report, _ = run("front")
    page = report.read_text()
    for name in ("effort, mean [N]", "effort, 99th percentile [N]", "effort above the limit 0.5 N"):
        assert name in page
    for arm in (*ARMS, "controller alone"):
        assert f"<td>{arm}</td>" in page
    assert "limit of single episodes" in (report.parent / "figures/front.svg").read_text()
    with (report.parent / "figures/front.csv").open() as file:
        final = [row for row in csv.DictReader(file) if row["evaluation"] == "final"]
    assert len(final) == len(ARMS) * 2
    for row in final:
        assert 0.0 < float(row["latest_effort"]) <= float(row["latest_effort_p99"])
        assert float(row["controller_effort"]) > 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"metric": "force"}, r"front.metric: expected one of env.metrics \(effort\), got 'force'"),
        ({"metric": None}, "expected one with figure: front, and only there, got None"),
        ({"figure": "table"}, "got 'effort' with figure: table"),
    ],
)
def test_a_front_without_its_quantity_is_explained(driven, folders, compose, change, message):
    write(driven / "configs/experiment/front.yaml", {**FRONT, **change})
    settings = load_settings(folders, {})
    with pytest.raises(ValueError, match=message):
        plan_points(load_experiments(["front"], folders), settings, compose)
