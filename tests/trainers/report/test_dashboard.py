"""The W&B dashboard, built and read back without a network, and held against what a run logs."""

import re
import sys

import numpy as np
import pytest

from rrl.trainers.cli.main import main
from rrl.trainers.evaluation.episodes import Comparison, Episodes
from rrl.trainers.report import dashboard
from rrl.trainers.report.panels import LENGTH

# the library defines its models in the style of Pydantic 1
pytestmark = pytest.mark.filterwarnings("ignore::pydantic.warnings.PydanticDeprecatedSince20")

ONE = np.ones(1)
METRICS = {"contact_force": ONE, "tilt": ONE}
EPISODES = Episodes(ONE, ONE.astype(int), ONE.astype(bool), ONE.astype(bool), METRICS)
LOGGED = [
    *(
        f"eval/misaligned/{name}"
        for name in Comparison(EPISODES, EPISODES, accepted=EPISODES).summary()
    ),
    *("acceptance/episodes", "acceptance/evidence", "acceptance/alpha_left"),
    *("action/residual_share", "action/residual_rms", "action/clip_fraction"),
    *("intervention/steps", "constraint/contact_force/multiplier", "realtime/faults"),
    *("train/reward", "train/reward_terms/tilt", "loss/loss_critic", "safety/force", "time/update"),
]


@pytest.fixture
def view():
    """What would be sent to the server."""
    return (
        dashboard.build("somebody", "rrl")._to_model().model_dump(by_alias=True, exclude_none=True)
    )


def sections(view):
    return {s["name"]: s["panels"] for s in view["spec"]["section"]["panelBankConfig"]["sections"]}


def test_every_group_of_metrics_has_its_section(view):
    found = sections(view)
    assert (view["entity"], view["project"]) == ("somebody", "rrl")
    for name in (
        "Learning",
        "Rescues and regressions",
        "Controller and residual",
        "Quantities",
    ):
        assert all(panel["viewType"] == "Run History Line Plot" for panel in found[name])
    media, *tables = found["Final evaluation"]
    assert media["config"]["mediaKeys"] == ["media/video", "media/learning_curve"]
    assert [str(table).count("results/success") for table in tables] == [1, 0]
    assert [panel["viewType"] for panel in found["Configuration"]] == ["Run Comparer"]


def test_runs_are_grouped_and_drawn_over_environment_steps(view):
    section = view["spec"]["section"]
    (runs,) = section["runSets"]
    assert [entry["name"] for entry in runs["grouping"]] == ["group", "jobType"]
    assert section["settings"]["xAxis"] == "env_steps"
    lines = [
        p["config"] for panels in sections(view).values() for p in panels if "Line" in p["viewType"]
    ]
    assert {line["xAxis"] for line in lines} == {"env_steps"}


def test_every_line_panel_finds_what_a_run_logs(view):
    for panels in sections(view).values():
        for panel in panels:
            if pattern := panel["config"].get("metricRegex"):
                assert [name for name in LOGGED if re.search(pattern, name)], pattern


def test_whatever_the_environment_reports_has_a_panel(view):
    first = sections(view)["Quantities"][0]["config"]["metricRegex"]
    assert first == "^eval/[^/]+/metrics/"
    found = [name for name in LOGGED if re.search(first, name)]
    assert [name.rpartition("/")[2] for name in found] == [
        *("contact_force", "contact_force_p99", "tilt", "tilt_p99"),
    ]


def test_a_panel_shows_controller_and_what_is_handed_over_beside_the_residual():
    pattern = dashboard.line_plot(LENGTH)["metric_regex"]
    found = [name for name in LOGGED if re.search(pattern, name)]
    assert found == [
        "eval/misaligned/episode_length",
        "eval/misaligned/controller_episode_length",
        "eval/misaligned/accepted_episode_length",
    ]


def test_what_is_missing_is_said(monkeypatch, capsys):
    assert main(["dashboard", "project=rrl"]) == 2
    assert "expected your W&B user or team" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "wandb_workspaces", None)
    monkeypatch.setitem(sys.modules, "wandb_workspaces.workspaces", None)
    monkeypatch.setitem(sys.modules, "wandb_workspaces.reports.v2", None)
    assert main(["dashboard", "entity=somebody"]) == 2
    assert "pip install -e '.[dashboard]' in the clone" in capsys.readouterr().err
