"""What cannot be exported is refused with the reason; an export that ends early leaves nothing."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs.transforms import Transform

from agents import random_policy
from exports import KEYS, point
from pixel_envs import PixelPoint
from rrl.deploy.policy import onnx_graph
from rrl.robot import RobotFault
from rrl.trainers.export.folder import export_policy
from rrl.transforms.base import RandomTransform


class Sorted(Transform):
    """Cannot be recorded: it leaves torch."""

    def _call(self, next_tensordict):
        goal = next_tensordict["goal"].numpy()
        return next_tensordict.set("goal", torch.from_numpy(np.sort(goal)))

    def forward(self, tensordict):
        return self._call(tensordict)

    def _reset(self, tensordict, tensordict_reset):
        return self._call(tensordict_reset)


class Upward(Sorted):
    """Cannot be recorded: it branches on a number."""

    def _call(self, next_tensordict):
        goal = next_tensordict["goal"]
        return next_tensordict.set("goal", -goal if goal.sum() < 0 else goal)


class Fault(RandomTransform):
    """A fault that does not say what is left without it."""

    def __init__(self):
        super().__init__(seed=0, stream="fault", in_keys=["goal"], out_keys=["goal"])

    def _first(self, td, mask):
        return {"goal": td["goal"]}

    def _advance(self, td, next_td, mask):
        return {"goal": next_td["goal"]}


@pytest.mark.parametrize(
    ("sensing", "message"),
    [
        (Sorted, "the chain cannot be exported: expected transforms and a policy of torch"),
        (Upward, "the chain cannot be exported: .* do not branch on numbers, got GuardOnData"),
        (Fault, r"Fault: expected a method silence\(\)"),
    ],
)
def test_a_chain_that_cannot_be_recorded_is_refused(sensing, message, tmp_path, capfd):
    factory = point(sensing=[sensing])
    with pytest.raises((ValueError, NotImplementedError), match=message):
        export_policy(factory, random_policy(point()), tmp_path / "export")
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_a_runtime_that_fails_is_not_blamed_on_the_chain(tmp_path, monkeypatch):
    def fails(values):
        raise RuntimeError("no memory")

    monkeypatch.setattr("rrl.trainers.export.folder.onnx_graph", lambda path: fails)
    with pytest.raises(ValueError, match=r"^policy\.onnx does not run: .*RuntimeError: no memory"):
        export_policy(point(), random_policy(point()), tmp_path / "export")


@pytest.mark.slow
@pytest.mark.parametrize("sees", [True, False])
def test_a_graph_that_does_not_see_the_picture_is_refused(tmp_path, monkeypatch, sees):
    def graph_of(path):
        graph = onnx_graph(path)
        return lambda given: graph(
            {name: v * sees if v.dtype == np.uint8 else v for name, v in given.items()}
        )

    monkeypatch.setattr("rrl.trainers.export.folder.onnx_graph", graph_of)
    factory = point(base=lambda num_envs=1: PixelPoint([num_envs]), inputs=["pixels", "goal"])
    if sees:
        export_policy(factory, random_policy(factory), tmp_path / "export")
    else:
        with pytest.raises(ValueError, match=r"policy\.onnx"):
            export_policy(factory, random_policy(factory), tmp_path / "export")


def test_what_is_not_installed_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    with pytest.raises(ImportError, match=r"onnxscript.*pip install -e '\.\[export\]'"):
        export_policy(point(), TensorDictModule(lambda: None, [], ["action"]), tmp_path / "export")


def silent(num_envs):
    raise RobotFault("no answer")


def test_a_robot_that_is_off_leaves_no_folder(tmp_path):
    with pytest.raises(RobotFault, match="no answer"):
        export_policy(point(base=silent), random_policy(point()), tmp_path / "export")
    assert not list(tmp_path.iterdir())


def stopped(features):
    raise KeyboardInterrupt


def test_ctrl_c_leaves_an_earlier_export_and_nothing_beside_it(tmp_path):
    folder = tmp_path / "export"
    folder.mkdir()
    (folder / "contract.json").write_text("an earlier export")
    policy = TensorDictModule(stopped, KEYS[:1], ["action"])
    with pytest.raises(KeyboardInterrupt):
        export_policy(point(), policy, folder)
    assert list(tmp_path.iterdir()) == [folder]
    assert (folder / "contract.json").read_text() == "an earlier export"
