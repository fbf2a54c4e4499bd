"""A run of the controller alone, whose video fails: what is there, and what is found in it again."""

import json
import sys

import pytest
import yaml

from rrl.trainers.cli import evaluate
from rrl.trainers.cli.main import main
from situation_commands import SMALL


@pytest.fixture(scope="module")
def controller_run(tmp_path_factory):
    """A run of the controller alone, whose video fails at its end."""
    run = tmp_path_factory.mktemp("controller") / "run"
    nothing = ["arm=controller", "trainer.total_steps=0", f"hydra.run.dir={run}"]
    film = ["render.enabled=true", "render.episode=rescue", "env.renderer.camera=nonsense"]
    assert main(["train", *SMALL, *nothing, *film]) == 0
    return run


def test_a_video_that_fails_costs_no_results(controller_run):
    for name in ("results.json", "report.html"):
        assert (controller_run / name).stat().st_size > 0
    assert not (controller_run / "videos").exists()


def test_the_controller_alone_is_evaluated_again(controller_run):
    assert main(["evaluate", f"run={controller_run}"]) == 0
    (again,) = controller_run.glob("evaluation-*.json")
    before = json.loads((controller_run / "results.json").read_text())
    for scenario, record in json.loads(again.read_text()).items():
        assert before[scenario]["episodes"].items() <= record["episodes"].items()


@pytest.fixture
def sweep(controller_run, tmp_path, monkeypatch):
    """Evaluates the run with 1 and with 2 episodes, in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", sys.argv)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    episodes = ["-m", "trainer.evaluation.final_episodes=1,2"]
    return lambda *changes: main(["evaluate", f"run={controller_run}", *episodes, *changes])


@pytest.mark.slow
def test_a_sweep_of_evaluations_says_what_each_was(controller_run, sweep, tmp_path, capsys):
    before = set(controller_run.glob("evaluation-*.json"))
    assert sweep() == 0
    assert not list(tmp_path.iterdir())
    assert "HYDRA" not in "".join(capsys.readouterr())  # its logging would outlive this output
    made = set(controller_run.glob("evaluation-*.json")) - before
    counts = []
    for path in made:
        asked = yaml.safe_load(path.with_suffix(".yaml").read_text())["trainer"]["evaluation"]
        records = json.loads(path.read_text()).values()
        counts.append(asked["final_episodes"])
        assert all(len(record["episodes"]["return"]) == counts[-1] for record in records)
    assert sorted(counts) == [1, 2]


def test_a_failed_evaluation_of_a_sweep_is_in_plain_words(sweep, capsys):
    fault = "{_target_:rrl.transforms.ObservationNoise,sigma:0.1,in_keys:[nowhere]}"
    assert sweep(f"+env.sensing.fault={fault}") == 2
    lines = capsys.readouterr().err.splitlines()
    assert len([line for line in lines if "): ObservationNoise: expected the entry" in line]) == 2


@pytest.mark.parametrize("changed", [False, True])
def test_a_rescue_is_found_in_the_results_where_they_are_of_this_configuration(
    controller_run, monkeypatch, capsys, changed
):
    results = json.loads((controller_run / "results.json").read_text())
    for record in results.values():
        record["episodes"] |= {"controller_success": [False, False], "success": [False, True]}
    (controller_run / "results.json").write_text(json.dumps(results))
    evaluated = []
    monkeypatch.setattr(evaluate, "Evaluator", lambda *a: evaluated.append(a) or 1 / 0)
    changes = ["trainer.evaluation.seed=7"] if changed else []
    filmed = ["env.renderer={_target_:situation_envs.black}", "render.format=gif", *changes]
    status = main(["render", f"run={controller_run}", *filmed])
    assert bool(evaluated) == changed
    assert status == (2 if changed else 0), capsys.readouterr().err
    if not changed:
        assert list(controller_run.glob("videos/*_episode_1.gif"))
