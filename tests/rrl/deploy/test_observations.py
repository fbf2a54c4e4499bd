"""Which observations an exported policy takes, and which it refuses as if nothing had been."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from exports import OBSERVATION, RATE, acts
from rrl.deploy import Policy
from rrl.deploy.contract import CONTRACT
from rrl.sealed import sealed


def test_lists_other_numbers_and_further_entries_are_taken(policy):
    plain = {"camera": "off", **{name: value.tolist() for name, value in OBSERVATION.items()}}
    expected = acts(policy, 1)
    policy.reset()
    np.testing.assert_array_equal([policy.act(plain)], expected)
    assert policy.act({**OBSERVATION, "goal": np.array([0, 1])}).dtype == np.float32


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
