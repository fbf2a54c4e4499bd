"""`rrl.deploy.Policy`: what it does with an exported folder or refuses, and that it needs no torch."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from exports import OBSERVATION, RATE, acts, export_with_memory
from rrl.deploy import Policy, read_contract
from rrl.deploy.archive import torch_graph
from rrl.deploy.contract import ARCHIVE, CONTRACT, MODEL
from rrl.sealed import sealed


@pytest.fixture(scope="module")
def unguarded(tmp_path_factory):
    """Without anything that deals with NaN."""
    return export_with_memory(tmp_path_factory.mktemp("unguarded") / "export", safety=[])


def test_it_remembers_within_an_episode_and_starts_anew_with_the_next(policy):
    first = acts(policy)
    assert all((a != b).any() for a, b in pairwise(first))
    policy.reset()
    np.testing.assert_array_equal(acts(policy), first)
    assert (policy.act(OBSERVATION) != first[0]).any()


def test_it_tells_what_the_command_is_made_of(policy):
    command = policy.act(OBSERVATION)
    assert command.shape == (2,)
    assert np.abs(command).max() <= np.float32(0.2)
    assert set(policy.reports) == {"base_action", "residual", "safety.step", "safety.finite"}
    assert policy.reports["safety.step"].all()
    assert not policy.reports["safety.finite"].any()
    wanted = (policy.reports["base_action"] + 0.5 * policy.reports["residual"]).clip(-1, 1)
    on_the_way = wanted * min(1.0, 0.2 / np.abs(wanted).max())
    np.testing.assert_allclose(command, on_the_way, atol=1e-6)


def test_torch_runs_the_same_graph(folder, policy):
    other = Policy(folder, RATE, graph=torch_graph(folder))
    np.testing.assert_allclose(acts(policy), acts(other), rtol=0, atol=1e-6)


@pytest.mark.parametrize("graph", [lambda folder: None, torch_graph])
def test_what_an_act_returns_belongs_to_the_caller(folder, graph):
    expected, policy = acts(Policy(folder, RATE)), Policy(folder, RATE, graph=graph(folder))
    for wanted in expected:
        command = policy.act(OBSERVATION)
        np.testing.assert_allclose(command, wanted, rtol=0, atol=1e-6)
        for array in (command, *policy.reports.values()):
            array.fill(0)


def test_the_contract_says_what_goes_in_and_comes_out(folder):
    contract = read_contract(folder)
    assert [(e.name, e.shape, e.unit) for e in contract.entries] == [
        ("end_effector_position", (2,), ""),
        ("goal", (2,), "m"),
    ]
    assert contract.rate == RATE
    assert {"PIDController.error_sum", "ActionHistory.given", "last.action", "starts"} <= {
        entry.name for entry in contract.state
    }
    content = contract.content
    assert (content["command"]["low"], content["command"]["high"]) == ([-1, -1], [1, 1])
    assert content["command"]["unit"] == "0.1 m"
    assert content["controller"]["class"].endswith("PIDController")
    assert content["controller"]["integral_gain"] == 0.5
    assert [node["class"].rpartition(".")[2] for node in content["safety"]] == [
        "StepLimit",
        "FiniteAction",
    ]
    assert content["safety"][0]["change"] == 0.2
    assert {"torch", "onnx", "onnxruntime"} <= content["versions"].keys()
    assert set(content["files"]) == {MODEL, ARCHIVE}


@pytest.mark.parametrize("rate", [None, 20.0, 51.0, "50", float("nan")])
def test_a_wrong_rate_is_refused(folder, rate):
    with pytest.raises(ValueError, match=f"rate: expected 50 control steps a second.*{rate}"):
        Policy(folder, rate)


@pytest.mark.parametrize("name", [MODEL, ARCHIVE, CONTRACT])
def test_a_changed_file_is_refused(folder, tmp_path, name):
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    if name == CONTRACT:
        (copy / name).write_text((copy / name).read_text().replace("0.02", "0.05"))
    else:
        with (copy / name).open("r+b") as file:
            file.seek(1000)
            byte = file.read(1)
            file.seek(1000)
            file.write(bytes([byte[0] ^ 1]))
    with pytest.raises(ValueError, match=rf"{name}: expected the .* that was exported"):
        Policy(copy, RATE)


def test_a_torn_foreign_or_newer_contract_is_refused(folder, tmp_path):
    with pytest.raises(FileNotFoundError, match="expected what `rrl export run=RUN` wrote"):
        Policy(tmp_path, RATE)
    path = Path(shutil.copytree(folder, tmp_path / "copy")) / CONTRACT
    content = json.loads(path.read_text())["content"]
    path.write_text(path.read_text()[:100])
    with pytest.raises(ValueError, match="torn"):
        Policy(path.parent, RATE)
    path.write_text(sealed({**content, "format": 99}))
    with pytest.raises(ValueError, match="expected format 1, got 99"):
        Policy(path.parent, RATE)


@pytest.mark.parametrize(("needs", "other"), [(MODEL, ARCHIVE), (ARCHIVE, MODEL)])
def test_a_robot_needs_the_graph_that_it_runs_and_no_other(folder, tmp_path, needs, other):
    def policy():
        return Policy(copy, RATE, graph=torch_graph(copy) if needs == ARCHIVE else None)

    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    (copy / other).unlink()
    policy().act(OBSERVATION)
    (copy / needs).unlink()
    with pytest.raises(FileNotFoundError, match=rf"{needs}: expected the graph that belongs"):
        policy()


def test_the_chain_deals_with_nan_as_it_was_configured(policy):
    executed = acts(policy)[-1]
    command = policy.act({**OBSERVATION, "goal": np.array([0.3, np.nan])})
    assert policy.reports["safety.finite"].all()
    np.testing.assert_array_equal(command, executed)  # replacement: last
    with pytest.raises(RuntimeError, match="expected reset"):
        policy.act(OBSERVATION)
    policy.reset()
    assert np.isfinite(policy.act(OBSERVATION)).all()


@pytest.mark.parametrize("broken", [np.nan, np.inf, 1e39])  # the last: in single precision
def test_without_a_guard_nan_is_refused(unguarded, broken):
    policy = Policy(unguarded, RATE)
    expected = acts(policy, 2)[1]
    policy.reset()
    policy.act(OBSERVATION)
    with pytest.raises(ValueError, match="goal: expected finite numbers"):
        policy.act({**OBSERVATION, "goal": np.array([broken, 0.0])})
    np.testing.assert_array_equal(policy.act(OBSERVATION), expected)


def test_a_command_that_is_not_finite_never_leaves(folder):
    nan = {"command": np.array([np.nan, 0.0], dtype=np.float32)}
    with pytest.raises(RuntimeError, match="command: expected finite numbers"):
        Policy(folder, RATE, graph=lambda inputs: nan).act(OBSERVATION)


WITHOUT_TORCH = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {"torch", "tensordict", "torchrl", "pydantic", "mujoco", "onnx", "hydra"}:
            raise ImportError(f"{name} is not on this robot")

sys.meta_path.insert(0, Blocked())
import numpy as np
from rrl.deploy import Policy

policy = Policy(sys.argv[1], rate=50.0)
observation = {"end_effector_position": np.array([0.1, 0.2]), "goal": np.array([0.3, -0.1])}
print([policy.act(observation).tolist() for _ in range(4)])
"""


def test_no_torch_is_needed(folder, policy):
    program = [sys.executable, "-W", "error", "-c", WITHOUT_TORCH, str(folder)]
    out = subprocess.run(program, capture_output=True, text=True, check=False)
    assert out.returncode == 0, out.stderr
    np.testing.assert_array_equal(json.loads(out.stdout), np.stack(acts(policy)).astype(float))
