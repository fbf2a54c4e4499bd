"""What a command says of an error: its place in the user's own code, and how to go on."""

import sys

import pytest

from rrl.trainers.cli.main import main
from situation_commands import SMALL

WRONG = """
from functools import partial
import numpy as np
import torch
from rrl.controllers import FunctionController

def act(position, deep):
    if deep:
        torch.stack([])
    return np.zeros(3)[99]

def controller(deep):
    return FunctionController(partial(act, deep=deep), ["end_effector_position"])
"""


@pytest.mark.parametrize(
    ("deep", "collection"),
    [(False, "turn"), (True, "turn"), pytest.param(True, "overlap", marks=pytest.mark.slow)],
)
def test_an_error_of_the_user_s_own_code_has_its_place(
    tmp_path, monkeypatch, capsys, deep, collection
):
    own = tmp_path / "configs/controller/wrong.yaml"
    own.parent.mkdir(parents=True)
    own.write_text(f"_target_: wrong_controller.controller\ndeep: {deep}\n")
    (tmp_path / "wrong_controller.py").write_text(WRONG)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "wrong_controller", raising=False)
    assert main(["train", *SMALL, "controller=wrong", f"trainer.collection={collection}"]) == 2
    del sys.modules["wrong_controller"]
    said = capsys.readouterr().err
    what = "non-empty TensorList" if deep else "index 99 is out of bounds for axis 0 with size 3"
    assert what in said
    assert f"(wrong_controller.py:{9 if deep else 10}, in act)" in said
    assert "RRL_TRACEBACK=1" in said


def test_a_module_that_is_not_there_is_named_once_and_where_it_is_looked_for(
    tmp_path, monkeypatch, capsys
):
    own = tmp_path / "configs/controller/absent.yaml"
    own.parent.mkdir(parents=True)
    inner = "{_target_: absent_project.pi.PI}"
    node = f"_target_: rrl.controllers.FunctionController\nfunction: {inner}\nin_keys: [goal]\n"
    own.write_text(node)
    monkeypatch.chdir(tmp_path)
    assert main(["train", *SMALL, "controller=absent"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("rrl train: controller.function: _target_: expected package.module.name")
    assert said.count("absent_project.pi.PI") == 1
    assert f"call rrl there, not in {tmp_path}" in said


def test_the_command_to_go_on_names_its_folder(tmp_path, monkeypatch, capsys):
    home = tmp_path / "my project"
    home.mkdir()
    monkeypatch.chdir(home)

    def breaks(trainer):
        trainer.counters["env_steps"] = 20
        return 1 / 0

    monkeypatch.setattr("rrl.trainers.training.trainer.Trainer.run", breaks)
    assert main(["train", *SMALL, "hydra.run.dir=run"]) == 2
    command = f"cd '{home}' && rrl train 'resume={home}/run'"
    assert f"to go on with it:\n  {command}\n" in capsys.readouterr().out


def test_an_error_with_a_message_of_ours_needs_no_more(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["train", *SMALL, "trainer.num_seeds=-1"]) == 2
    assert main(["train", f"resume={tmp_path}"]) == 2
    assert "RRL_TRACEBACK" not in capsys.readouterr().err


def test_a_run_without_a_renderer_says_so_once(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    nothing = ["arm=controller", "trainer.total_steps=0", "env.renderer=null"]
    assert main(["train", *SMALL, *nothing, "render.enabled=true"]) == 0
    assert capsys.readouterr().out.count("no video: env.renderer is not set") == 1
