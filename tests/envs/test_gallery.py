"""Every task of the gallery with its controller: specs, scores, episodes that can be played again."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import pytest
import yaml
from torchrl.envs.utils import check_env_specs

from rrl.trainers.cli.compose import compose
from rrl.trainers.configuration import build as assembly
from rrl.trainers.evaluation.evaluator import Evaluator
from rrl.trainers.seeds import Stream

EXPERIMENT = Path(__file__).parents[2] / "configs/experiment/gallery.yaml"
ARMS = yaml.safe_load(EXPERIMENT.read_text(encoding="utf-8"))["arms"]
EPISODES = 6
SCORES = {
    "peg-insert-side, as shipped": (0.3, 1.0),
    "peg-insert-side, action bias": (0.0, 0.7),
    "push, as shipped": (0.6, 1.0),
    "push, object seen 4 cm off": (0.1, 0.9),
    "drawer-open, as shipped": (0.6, 1.0),
    "drawer-open, object seen 4 cm off": (0.0, 0.5),
    "hammer, as shipped": (0.6, 1.0),
    "hammer, action bias": (0.0, 0.9),
    "door-open, as shipped": (0.6, 1.0),
    "door-open, action bias": (0.2, 1.0),
    "FetchPush, hand controller": (0.5, 1.0),
    "FetchPickAndPlace, hand controller": (0.5, 1.0),
    "Lift, script": (0.3, 1.0),
    "cartpole, pole's feedback": (300.0, 700.0),
    "Jaco reach, target seen 6 cm off": (150.0, 245.0),
    "lunar lander, as shipped": (200.0, 320.0),
    "lunar lander, weak main engine": (0.0, 300.0),
    "double pendulum, wrong gravity": (100.0, 1872.0),
}
"""Least and largest share of success, or mean return where a task reports no success."""

# The packages warn of one another, and of what Python will do.
pytestmark = pytest.mark.filterwarnings("ignore")


SLOW = "Jaco reach, target seen 6 cm off"


@pytest.fixture(params=[pytest.param(a, marks=pytest.mark.slow if a == SLOW else ()) for a in ARMS])
def arm(request) -> str:
    for package in compose(ARMS[request.param])["env"]["packages"]:
        try:
            version(package)
        except PackageNotFoundError:
            pytest.skip(f"{package} is not installed: pip install -e '.[gallery]' in the clone")
    return request.param


def test_specs_score_and_frozen_episodes(arm) -> None:
    config = compose(ARMS[arm])
    environment = assembly.environment(config).make(1)
    check_env_specs(environment)
    environment.close()

    evaluator = Evaluator(assembly.scenarios(config), assembly.settings(config).evaluation)
    assert evaluator.is_frozen(evaluator.followed)
    episodes = evaluator.controller(evaluator.followed, Stream.FINAL, EPISODES)
    evaluator.close()
    low, high = SCORES[arm]
    value = episodes.returns if episodes.success is None else episodes.success
    assert low <= value.mean() <= high
    assert episodes.lengths.max() <= config["env"]["max_episode_steps"]
    assert not episodes.diverged.any()


def test_every_task_has_an_expected_score() -> None:
    assert set(SCORES) == set(ARMS)


def test_an_unknown_task_is_answered_with_the_known_ones() -> None:
    pytest.importorskip("metaworld")
    from rrl.envs.gallery.metaworld import make

    with pytest.raises(ValueError, match=r"expected one of assembly, .*, got 'peg'"):
        make("peg")


def test_a_missing_package_is_named(monkeypatch) -> None:
    from rrl.envs.gallery import packages

    monkeypatch.setitem(__import__("sys").modules, "metaworld", None)
    with pytest.raises(
        ModuleNotFoundError, match=r"gallery's packages .* pip install -e '\.\[gallery\]'"
    ):
        packages.metaworld()
