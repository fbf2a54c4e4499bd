"""`rrl.deploy.Policy`: what it does with an exported folder, what it refuses, and that it needs no torch."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from agents import random_policy
from rrl.algorithms import TD3, mlp
from rrl.controllers import PIDController
from rrl.deploy import Policy, read_contract
from rrl.deploy.archive import torch_graph
from rrl.deploy.contract import ARCHIVE, CONTRACT, MODEL
from rrl.sealed import sealed
from rrl.trainers.environment import EnvironmentFactory
from rrl.trainers.export.folder import export_policy
from rrl.transforms import FiniteAction, StepLimit
from toy_envs import PointMass

RATE = 50.0
OBSERVATION = {"end_effector_position": np.array([0.1, 0.2]), "goal": np.array([0.3, -0.1])}


def point(**changes):
    """A point under a controller with memory, whose steps are limited."""
    return EnvironmentFactory(
        **{
            "base": lambda num_envs=1: PointMass([num_envs]),
            "controller": partial(PIDController, gain=2.0, integral_gain=0.5, time_step=0.02),
            "inputs": ["end_effector_position", "goal", "previous_action"],
            "residual_scale": 0.5,
            "safety": [partial(StepLimit, change=0.2), partial(FiniteAction, replacement="last")],
            "control_period": 1 / RATE,
            "units": {"goal": "m", "action": "0.1 m"},
            **changes,
        }
    )


def export(folder, **changes):
    factory = point(**changes)
    policy = random_policy(factory, partial(TD3, network=partial(mlp, hidden=[16, 16])))
    export_policy(factory, policy, folder)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return export(tmp_path_factory.mktemp("point") / "export")


@pytest.fixture(scope="module")
def unguarded(tmp_path_factory):
    """Without anything that deals with NaN."""
    return export(tmp_path_factory.mktemp("unguarded") / "export", safety=[])


@pytest.fixture
def policy(folder):
    return Policy(folder, RATE)


def acts(policy, steps=4, **changes):
    return [policy.act({**OBSERVATION, **changes}).copy() for _ in range(steps)]


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


def test_lists_other_numbers_and_further_entries_are_taken(policy):
    plain = {"camera": "off", **{name: value.tolist() for name, value in OBSERVATION.items()}}
    expected = acts(policy, 1)
    policy.reset()
    np.testing.assert_array_equal([policy.act(plain)], expected)
    assert policy.act({**OBSERVATION, "goal": np.array([0, 1])}).dtype == np.float32


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


GOAL, POSITION = OBSERVATION["goal"], OBSERVATION["end_effector_position"]


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        ({"goal": GOAL}, r"without \['end_effector_position'\]"),
        ({}, "without"),
        ({"goal": GOAL, "end_effector_position": POSITION}, r"in the order \['goal'"),
        ([POSITION, GOAL], "expected a mapping with .* got a list"),
        ({**OBSERVATION, "goal": GOAL[None]}, r"goal: expected the shape \(2,\), got \(1, 2\)"),
        ({**OBSERVATION, "goal": np.zeros(3)}, r"goal: expected the shape \(2,\), got \(3,\)"),
        ({**OBSERVATION, "goal": GOAL.astype(complex)}, "goal: expected float32, got complex128"),
    ],
)
def test_entries_that_are_not_the_contracts_are_refused(policy, observation, message):
    expected = acts(policy, 2)[1]
    policy.reset()
    policy.act(OBSERVATION)
    with pytest.raises(ValueError, match=message):
        policy.act(observation)
    np.testing.assert_array_equal(policy.act(OBSERVATION), expected)  # as if nothing had been


def with_another_goal(folder, copy, **changes):
    """A policy whose contract says something else of the goal, and what its graph is shown."""
    path = Path(shutil.copytree(folder, copy)) / CONTRACT
    content = json.loads(path.read_text())["content"]
    content["entries"][1].update(changes)
    path.write_text(sealed(content))
    shown = []
    nothing = {f"report/{e['name']}": np.zeros(1) for e in content["reports"]}
    nothing |= {f"next/{e['name']}": np.zeros(1) for e in content["state"]}

    def graph(inputs):
        shown.append(inputs)
        return {"command": np.zeros(2), **nothing}

    return Policy(copy, RATE, graph), shown


def test_integers_that_the_entry_cannot_hold_are_refused(folder, tmp_path):
    policy, shown = with_another_goal(folder, tmp_path / "copy", dtype="uint8")
    with pytest.raises(
        ValueError, match=r"goal: expected numbers that uint8 holds, got \[300, 2\]"
    ):
        policy.act({**OBSERVATION, "goal": np.array([300, 2], np.uint16)})
    policy.act({**OBSERVATION, "goal": np.array([255, 2], np.uint16)})
    assert [inputs["entry/goal"].tolist() for inputs in shown] == [[255, 2]]


@pytest.mark.parametrize(
    ("dtype", "goal", "shown"),
    [
        ("bool", [1, 0], [True, False]),
        ("int16", [3.0, -4.0], [3, -4]),
        ("bool", [0.5, 0], None),
        ("int16", [np.nan, 0.0], None),
        ("float32", ["0", "1"], None),
    ],
)
def test_a_type_is_as_strict_as_in_training(folder, tmp_path, dtype, goal, shown):
    policy, seen = with_another_goal(folder, tmp_path / "copy", dtype=dtype)
    if shown is None:
        with pytest.raises(ValueError, match=f"goal: expected (numbers that )?{dtype}"):
            policy.act({**OBSERVATION, "goal": goal})
    else:
        policy.act({**OBSERVATION, "goal": goal})
        assert seen[0]["entry/goal"].tolist() == shown


@pytest.mark.parametrize("name", ["arm.goal", "arm/goal"])
@pytest.mark.parametrize("goal", [0.5, np.float64(0.5), np.array(0.5), [0.5]])
def test_what_a_robot_observes_is_taken_as_it_is(folder, tmp_path, name, goal):
    """`RobotEnv` makes one number of an entry without shape, and nests a name with a slash."""
    policy, shown = with_another_goal(folder, tmp_path / "copy", name="arm.goal", shape=[1])
    policy.act({"end_effector_position": POSITION, "arm/speed": 1.0, name: goal})
    assert shown[0]["entry/arm.goal"].tolist() == [0.5]
    with pytest.raises(ValueError, match=r"without \['arm\.goal'\]"):
        policy.act({"end_effector_position": POSITION})


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
