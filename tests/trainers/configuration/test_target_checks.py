"""What a configuration names by ``_target_`` is checked as far as it can be, and refused only for what is wrong."""

import re
from contextlib import nullcontext
from typing import ClassVar

import pytest
import torch

from rrl.algorithms import TD3
from rrl.controllers import ZeroController
from rrl.trainers.cli.compose import compose
from rrl.trainers.cli.main import main
from rrl.trainers.configuration import build as assembly
from situation_commands import SMALL


class NeedsPixels(torch.nn.Module):
    """An encoder, and a network, that nothing but the real entries and sizes will do for."""

    def __init__(self, inputs=None, in_features=0, out_features=0):
        super().__init__()
        assert "pixels" in (inputs or {}) or in_features > 50


class LooksForPixels(TD3):
    """A learner that looks up its entries."""

    def __init__(self, inputs, action_size, **settings):
        super().__init__({"pixels": inputs["pixels"]}, action_size, **settings)


@pytest.mark.parametrize("part", ["encoder", "network"])
@pytest.mark.parametrize("wrong", [{}, {"actor_lr": -0.001}])
def test_parts_that_need_the_real_entries_are_not_tried_on_others(part, wrong):
    config = compose(["env=insertion-pixels"])
    config["algorithm"]["agent"] |= {part: {"_target_": f"{__name__}.NeedsPixels"}, **wrong}
    assert_said_of(config, "algorithm.agent.actor_lr" if wrong else "")


@pytest.mark.parametrize("wrong", [{}, {"actor_lr": -0.001}])
def test_a_learner_that_needs_the_real_entries_is_not_tried_on_others(wrong):
    config = compose(["env=insertion-pixels"])
    config["algorithm"]["agent"] |= {"_target_": f"{__name__}.LooksForPixels", **wrong}
    assert_said_of(config, "algorithm.agent.actor_lr" if wrong else "")


def assert_said_of(config, where):
    with pytest.raises(ValueError, match=rf"^{re.escape(where)}: ") if where else nullcontext():
        assembly.check(config)


def film(env, states, width, height):
    """As documented."""


def film_anyhow(*args, **kwargs):
    """Takes whatever comes."""


def film_in_one_size(env, states, height=64):
    """Takes no width."""


@pytest.mark.parametrize(
    ("renderer", "said"),
    [
        (film, ""),
        (film_anyhow, ""),
        (film_in_one_size, "env.renderer: expected a function .* without width"),
    ],
)
def test_a_renderer_takes_what_it_is_called_with(renderer, said):
    config = compose(["env=insertion-sim"])
    config["env"]["renderer"] = {"_target_": f"{__name__}.{renderer.__name__}"}
    with pytest.raises(ValueError, match=said) if said else nullcontext():
        assembly.check(config)


def test_what_is_wrong_with_the_environment_is_not_said_of_every_scenario():
    config = compose(["env=insertion-sim", "env.base._target_=absent.Env"])
    config["env"]["scenarios"]["other"] = {"_target_": "lost.Env"}
    with pytest.raises(ValueError) as caught:
        assembly.check(config)
    lines = str(caught.value).splitlines()
    assert [line.partition(": ")[0] for line in lines] == ["env.base", "env.scenarios.other"]


class Made(ZeroController):
    """Counts its kind; stands for everything that a configuration names."""

    made: ClassVar = []

    def __init__(self, as_what="controller", robot=None, num_envs=1):
        super().__init__()
        self.made.append(as_what)


@pytest.fixture
def counted():
    """Nothing is made so far; a configuration that makes it in many places."""
    Made.made.clear()
    config = compose(["env=robot/plant", "logger=[csv,tensorboard,wandb]"])

    def node(as_what):
        return {"_target_": f"{__name__}.Made", "as_what": as_what}

    config["controller"] = node("controller")
    config["env"]["base"] = {**node("environment"), "robot": node("robot")}
    config["env"]["scenarios"] = {"other": {"robot": node("another robot")}}
    return config


def test_a_check_makes_a_controller_and_no_environment_robot_or_file(
    counted, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assembly.check(counted, training=True, new=True)
    assert Made.made == ["controller"]
    assert not [*tmp_path.iterdir()]


def test_a_function_is_never_called_by_a_check(counted):
    counted["controller"] = {"_target_": f"{__name__}.fails"}
    counted["env"]["renderer"] = {"_target_": f"{__name__}.film_anyhow"}
    assembly.check(counted)


def fails():
    raise AssertionError("called")


def test_a_command_checks_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    checks = []
    monkeypatch.setattr(assembly.checks, "problems", lambda *_, **how: checks.append(how) or [])
    assert main(["train", *SMALL, "hydra.run.dir=run"]) == 0
    assert checks == [{"training": True, "new": True}]
