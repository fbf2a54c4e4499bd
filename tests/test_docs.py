"""The documentation is right: its snippets run, its commands are accepted, its links lead somewhere."""

import importlib.util
import json
import re
import shlex
import sys
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import yaml
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf

from agents import random_policy
from rrl.algorithms import TD3, mlp
from rrl.controllers import ProportionalController
from rrl.trainers.cli.compose import compose as compose_project
from rrl.trainers.cli.compose import plain_name
from rrl.trainers.cli.main import COMMANDS, main
from rrl.trainers.cli.new import create
from rrl.trainers.configuration import build as assembly
from rrl.trainers.environment import EnvironmentFactory, Input
from rrl.trainers.export.folder import export_policy
from rrl.transforms import StepLimit
from toy_envs import PointMass

EXTRAS = {"metaworld": "metaworld", "fetch": "gymnasium_robotics", "robosuite": "robosuite"}
"""Modules of rrl.envs.gallery, and the packages that they need."""
ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "examples/README.md", *sorted((ROOT / "docs").glob("*.md"))]
POINT = re.compile(r"\[([+-]?\d[\d.]*)((?: ?%)?), \1\2\]")
"""An interval of zero width, which would say that something is certain."""

RUN_ELSEWHERE = {("python", "robot.md"), ("yaml", "robot.md")}
"""tests/test_robot_page.py runs these: they need a plant, and one another."""


def blocks(language, documents=DOCUMENTS):
    """Fenced blocks of documents, named by their place."""
    for document in documents:
        if (language, document.name) in RUN_ELSEWHERE:
            continue
        text = document.read_text()
        for found in re.finditer(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
            line = text[: found.start()].count("\n") + 2
            yield pytest.param(found[1], id=f"{document.relative_to(ROOT)}:{line}")


def file_of(snippet):
    """The file of a project that a block is, by its first line; empty: none."""
    found = re.match(r"# ((configs|my_project)/\S+)\n", snippet)
    return found[1] if found else ""


YOUR_TASK = [ROOT / "docs/your_task.md"]
PROJECT = [b for lang in ("yaml", "python") for b in blocks(lang, YOUR_TASK) if file_of(*b.values)]
TASKS = [b for b in blocks("python", YOUR_TASK) if b not in PROJECT]
TASKS, OTHERWISE = TASKS[:-1], TASKS[-1]
"""How to train and tasks to train on; how to train otherwise."""


def commands():
    """Every shell command of every document."""
    for block in blocks("sh"):
        for line in block.values[0].splitlines():
            for command in re.sub(r"(^|\s)#.*", "", line).split("&&"):
                if command.strip():
                    yield pytest.param(shlex.split(command), id=f"{block.id} {command.strip()}")


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_no_interval_has_zero_width(document):
    assert [found[0] for found in POINT.finditer(document.read_text())] == []


@pytest.mark.parametrize("text", ["[100.0, 100.0] %", "[+0.0, +0.0]", "[100%, 100%]", "[-1, -1]"])
def test_an_interval_of_zero_width_is_recognized(text):
    assert POINT.search(text)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A point's policy as ``rrl export`` writes it."""
    point = EnvironmentFactory(
        base=lambda num_envs=1: PointMass([num_envs]),
        controller=partial(ProportionalController, gain=1.0),
        inputs=["end_effector_position", "goal"],
        safety=[partial(StepLimit, change=0.2)],
        control_period=0.05,
    )
    policy = random_policy(point, partial(TD3, network=partial(mlp, hidden=[8])))
    exported = tmp_path_factory.mktemp("run") / "export"
    export_policy(point, policy, exported)
    return exported


class Robot:
    """Goes where it is told."""

    position = np.zeros(2)

    def observe(self):
        return self.position, np.ones(2)

    def move(self, command):
        self.position = self.position + 0.1 * command


@pytest.mark.parametrize("snippet", [*blocks("python")])
@pytest.mark.filterwarnings("ignore:::(?!rrl)")  # the gallery's packages warn of one another
def test_python_runs(snippet, folder):
    skip_without_packages(snippet)
    user_has = {
        "base": PointMass([1]),
        "controller": ProportionalController("end_effector_position", gain=1.0),
        "folder": folder,
        "robot": Robot(),
    }
    names = dict(user_has)
    exec(compile(snippet, "snippet", "exec"), names)
    if "env" in names:
        assert names["env"].rollout(2)["base_action"].shape[-1] > 0


def skip_without_packages(snippet):
    for module in re.findall(r"from rrl.envs.gallery import (\w+)", snippet):
        pytest.importorskip(EXTRAS[module], exc_type=ImportError)


@pytest.mark.parametrize("snippet", TASKS[1:])
@pytest.mark.filterwarnings("ignore:::(?!rrl)")
def test_a_task_is_played(snippet, tmp_path):
    """The document's first snippet plays an episode of the controller; nothing is learned."""
    skip_without_packages(snippet)
    names = {}
    for each in (TASKS[0].values[0], snippet):
        exec(compile(each, "snippet", "exec"), names)
    environment = replace(names["environment"], max_episode_steps=10)  # of an evaluation
    few = {"every": 0, "episodes": 1, "final_episodes": 1}
    summary = names["train"](environment, tmp_path, total_steps=0, evaluation=few)
    assert summary["return"] == summary["controller_return"]


def test_a_run_with_other_settings_goes_on(tmp_path):
    names = {}
    for each in (TASKS[1], OTHERWISE):
        exec(compile(each.values[0], "snippet", "exec"), names)
    tiny = {"steps_per_collection": 10, "batch_size": 8, "acceptance": {"episodes": 2}}
    tiny |= {"warmup_steps": 20, "evaluation": {"every": 0, "episodes": 1, "final_episodes": 1}}
    tiny["checkpoint"] = {"every": 0}
    environment = replace(names["environment"], max_episode_steps=10)
    for steps in (30, 40):
        names["train_otherwise"](environment, tmp_path, steps > 30, total_steps=steps, **tiny)
    assert len(list((tmp_path / "checkpoints").iterdir())) == 2


def test_a_project_s_files_are_trained_on(tmp_path, monkeypatch):
    create("my_project", tmp_path)
    project = tmp_path / "my_project"
    for (snippet,) in (block.values for block in PROJECT):
        (project / file_of(snippet)).write_text(snippet)
    monkeypatch.chdir(project)
    monkeypatch.syspath_prepend(project)
    few = [f"trainer.evaluation.{name}=2" for name in ("episodes", "final_episodes", "slots")]
    few += ["trainer.total_steps=0", "arm=controller", "render.enabled=false", "logger=csv"]
    assert main(["train", "env=reacher", "controller=reacher", "hydra.run.dir=run", *few]) == 0
    for name in [name for name in sys.modules if name.partition(".")[0] == "my_project"]:
        del sys.modules[name]
    (record,) = json.loads((project / "run/results.json").read_text()).values()
    assert record["episodes"]["success"] == record["episodes"]["controller_success"]


def lines_of_the_user(snippet):
    """Lines but imports, comments, and brackets alone."""
    lines = (line.split("#")[0].strip(" )]},") for line in snippet.splitlines())
    return [line for line in lines if line and not line.startswith(("import ", "from "))]


@pytest.mark.parametrize("snippet", [*TASKS, OTHERWISE])
def test_twelve_lines_are_enough_for_a_task(snippet):
    assert len(lines_of_the_user(snippet)) <= 12
    assert "class" not in snippet


def test_an_encoder_of_one_s_own_is_configured_and_made(tmp_path, monkeypatch):
    (snippet,) = (b.values[0] for b in blocks("yaml") if "algorithm" in yaml.safe_load(*b.values))
    (tmp_path / "configs/algorithm").mkdir(parents=True)
    (tmp_path / "configs/algorithm/mine.yaml").write_text(snippet)
    network = partial(torch.nn.Sequential, torch.nn.AvgPool2d(32), torch.nn.Flatten())
    monkeypatch.setitem(sys.modules, "my_package", SimpleNamespace(my_network=network))
    overrides = ["env=insertion-pixels", "algorithm=mine"]
    config = compose_project(overrides, tmp_path / "configs")
    assembly.check(config)
    inputs = {"pixels": Input(shape=(64, 64, 3), channels="last"), "goal": Input(shape=(3,))}
    assert assembly.agent(config)(inputs=inputs, action_size=3).encoder.out_features == 12 + 3


ENVIRONMENTS = [b for b in blocks("yaml") if "algorithm" not in yaml.safe_load(*b.values)]


@pytest.mark.parametrize("snippet", [b for b in ENVIRONMENTS if b not in PROJECT])
def test_yaml_describes_an_environment(snippet):
    described = yaml.safe_load(snippet)
    if "inputs" in described:
        assert all(Input(**(entry or {})) for entry in described["inputs"].values())
        return
    inputs = {"position": Input(), "goal": Input(), "base_action": Input()}
    environment = EnvironmentFactory(lambda: None, lambda: None, inputs, **described)
    assert environment.symmetry().num_images > 1


@pytest.mark.parametrize("command", [*commands()])
def test_a_command_is_accepted(command, tmp_path, monkeypatch):
    program, *arguments = command
    known = {"rrl": check_rrl, "make": check_make, "pip": check_pip, "python": check_python}
    if program in known:
        known[program](arguments, tmp_path, monkeypatch)
    else:
        assert program in {"cd", "git", "wandb", "tensorboard"}, f"nothing here checks {program!r}"


def check_rrl(arguments, tmp_path, monkeypatch):
    command, *rest = arguments
    assert command in COMMANDS
    changes = [a for a in rest if "=" in a and not a.startswith(("run=", "resume="))]
    if command in ("train", "evaluate", "render", "export"):
        assembly.check(composed(changes, tmp_path, monkeypatch))
    elif command == "new":
        assert create(rest[0], tmp_path)
    elif command == "reproduce":
        assert {a for a in rest if "=" not in a} <= {
            path.stem for path in (ROOT / "configs/experiment").iterdir()
        }
        assert {a.partition("=")[0] for a in changes} <= set(
            yaml.safe_load((ROOT / "configs/reproduce.yaml").read_text())
        )
    else:
        keys = {"report": {"out"}, "dashboard": {"entity", "project"}}[command]
        assert {a.partition("=")[0] for a in changes} <= keys


def composed(changes, folder, monkeypatch):
    """The configuration, in a project made by ``rrl new`` where the command names one."""
    search = []
    if any("my_project" in change for change in changes):
        create("my_project", folder)
        monkeypatch.syspath_prepend(folder / "my_project")
        search = [f"hydra.searchpath=[file://{folder}/my_project/configs]"]
    OmegaConf.register_new_resolver("plain", plain_name, replace=True)
    with initialize_config_module("rrl.configs", version_base="1.3"):
        config = compose("train", overrides=[*search, *changes])
    return OmegaConf.to_container(config, resolve=True, throw_on_missing=True)


def check_make(arguments, *_):
    targets = set(re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert {a for a in arguments if "=" not in a} <= targets


def check_pip(arguments, *_):
    extras = set(re.findall(r"^(\w+) = \[$", (ROOT / "pyproject.toml").read_text(), re.MULTILINE))
    named = chain.from_iterable(re.findall(r"rrl\[(.*?)\]", argument) for argument in arguments)
    assert {extra for extras_of in named for extra in extras_of.split(",")} <= extras


def check_python(arguments, *_):
    if arguments[0] == "-m":
        name = arguments[1].removeprefix("rrl.") if "rrl.envs" in arguments[1] else arguments[1]
        module = ROOT / name.replace(".", "/")
        assert module.with_suffix(".py").is_file() or (module / "__main__.py").is_file()
        return
    assert (ROOT / arguments[0]).is_file() or "NAME" in arguments[0]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_somewhere(document):
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", document.read_text()):
        assert (document.parent / target).exists(), target


@pytest.mark.slow
def test_the_reference_is_built_without_warnings(tmp_path):
    spec = importlib.util.spec_from_file_location("reference", ROOT / "docs/reference.py")
    reference = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(reference)
    reference.build(tmp_path)
    page = (tmp_path / "rrl/transforms.html").read_text()
    assert "ResidualAction" in page
    for name in reference.modules():
        assert (tmp_path / f"{name.replace('.', '/')}.html").is_file(), name
    assert "rrl.trainers" in sys.modules
