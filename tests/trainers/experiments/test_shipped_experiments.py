"""Our experiments, the ten of the paper among them, are made of valid runs."""

import pytest
import yaml

from experiment_project import OURS
from rrl.trainers.cli.compose import compose as compose_config
from rrl.trainers.configuration import build as assembly
from rrl.trainers.configuration import checks
from rrl.trainers.evaluation.episodes import write_results
from rrl.trainers.experiments.plan import plan_points
from rrl.trainers.experiments.spec import load_experiments, load_settings


def shipped_points(scale, names=()):
    settings = load_settings([OURS], {"scale": scale})
    return plan_points(load_experiments(names, [OURS]), settings, compose_config)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A short run of the source of sim-to-real, for those that start from it."""
    run_dir = tmp_path_factory.mktemp("source")
    point = next(p for p in shipped_points("quick", ["sim-to-real"]) if not p.shown)
    settings = {"total_steps": 100, "warmup_steps": 50, "batch_size": 16}
    evaluation = {"every": 0, "episodes": 1, "final_episodes": 1, "seed": 0, "slots": 1}
    trainer = {**point.config["trainer"], **settings, "evaluation": evaluation}
    agent = {**point.config["algorithm"]["agent"], "compiled": False}
    config = {
        **point.config,
        "trainer": trainer,
        "algorithm": {**point.config["algorithm"], "agent": agent},
    }
    with assembly.trainer(config, run_dir) as made:
        write_results(made.run(), run_dir / "results.json")
    (run_dir / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    return run_dir


def test_the_papers_ten_experiments_are_there():
    assert len({point.experiment for point in shipped_points("quick")}) == 10


@pytest.mark.parametrize("scale", ["quick", pytest.param("paper", marks=pytest.mark.slow)])
def test_every_experiment_is_made_of_valid_runs(scale, source):
    arms = {
        (point.experiment, point.arm): point for point in shipped_points(scale)
    }  # at the last setting
    for point in {point.key: point for point in arms.values()}.values():
        config = point.config
        if point.sources:
            overrides = [o.replace("run:sim-policy", f"'{source}'") for o in point.overrides]
            config = compose_config(overrides)
        assert not checks.problems(config), point.name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gallery", "ablation", "pixels"])
def test_other_peoples_tasks_are_made_of_valid_runs(name):
    if name != "pixels":
        pytest.importorskip("metaworld", reason="needs pip install -e '.[gallery]' in the clone")
    points = shipped_points("quick", [name])
    assert len({point.key for point in points}) == len(points)
    for point in points:
        assert not checks.problems(point.config), point.name


def test_the_blind_arm_is_the_arm_with_a_camera_but_for_the_camera():
    configs = {point.arm: point.config for point in shipped_points("quick", ["pixels"])}
    camera = {"_target_", "camera", "picture_size", "camera_shift", "light_shift"}
    found = []
    for arm in ("pixels", "blind"):
        env, rest = configs[arm]["env"], {**configs[arm], "env": None, "name": None}
        base = {key: value for key, value in env["base"].items() if key not in camera}
        inputs = {key: entry for key, entry in env["inputs"].items() if key != "pixels"}
        found.append((base, inputs, env["metrics"], env["action_history"], rest))
    assert found[0] == found[1]
    assert "blocks" not in configs["pixels"]["env"]["inputs"]
    assert "blocks" in configs["tracked poses"]["env"]["inputs"]
