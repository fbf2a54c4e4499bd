"""How many steps a run needs with somebody's help: planned, run and shown."""

from pathlib import Path

import pytest

from experiment_project import write
from rrl.trainers.cli.compose import compose as compose_config
from rrl.trainers.configuration import build
from rrl.trainers.experiments.plan import plan_points
from rrl.trainers.experiments.spec import load_experiments, load_settings

CONFIGS = Path(__file__).parents[3] / "configs"
OPERATOR = """{intervention: {_target_: rrl.Intervention, step_limit: 0.5, operator: {
  _target_: rrl.ScriptedOperator, share: SHARE, controller: {
    _target_: rrl.ProportionalController, gain: 10.0}}}}"""


def test_arms_are_shares_of_a_competent_and_a_clumsy_operator():
    settings = load_settings([CONFIGS], {"scale": "paper"})
    points = plan_points(load_experiments(["interventions"], [CONFIGS]), settings, compose_config)
    found = []
    for point in points:
        build.check(point.config)
        assert len(point.seeds) == 10
        if node := point.config["operator"]["intervention"]:
            found.append((node["operator"]["noise"] > 0, node["operator"]["share"]))
            assert point.config["trainer"]["intervention_share"] == 0.25
    assert found == [(clumsy, share) for clumsy in (False, True) for share in (0.05, 0.1, 0.2)]
    assert len(points) == 7


@pytest.mark.slow
def test_the_report_says_how_many_steps_each_arm_needed(project, run):
    helped = [f"operator={OPERATOR.replace('SHARE', '0.5')}", "trainer.intervention_share=0.25"]
    arms = {"nobody": ["operator=none"], "half": [o.replace("\n", "") for o in helped]}
    write(
        project / "configs/experiment/help.yaml",
        {"title": "Help on the way", "figure": "curves", "by_name": True, "arms": arms},
    )
    page = run("help")[0].read_text()
    assert "environment steps to 90%, by seed" in page
    for arm in arms:
        assert f"<td>{arm}</td>" in page
    assert list(project.glob("out/runs/help-half-*/seed-0/results.json"))
