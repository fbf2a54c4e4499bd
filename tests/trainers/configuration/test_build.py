"""What YAML can say: nested entries, and targets inside of targets."""

import pytest
import torch
import yaml
from torchrl.data import Unbounded

from rrl.trainers.cli.compose import compose
from rrl.trainers.configuration import build as assembly
from rrl.trainers.training.interface import interface_of
from situation_envs import Simulator

ENV = f"""
name: arm
base: {{_target_: {__name__}.Arm}}
batching: serial
max_episode_steps: 8
inputs: {{arm.q: {{scale: 2.0}}, flat.name: {{}}}}
critic_inputs: {{arm.q: {{}}, arm.hand.goal: {{}}}}
sensing:
  stack: {{_target_: torchrl.envs.CatFrames, N: 2, dim: -1, in_keys: [[arm, q]], out_keys: [[arm, q]]}}
scenarios: {{training: null}}
"""
BACK = f"""
_target_: rrl.controllers.FunctionController
in_keys: [[arm, hand, goal]]
function: {{_target_: {__name__}.back}}
"""
TRACK = """
_target_: rrl.controllers.ProportionalController
position_key: [arm, hand, goal]
goal_key: flat.name
"""


class Arm(Simulator):
    """Shows nested entries, and one whose name has a dot."""

    def __init__(self):
        super().__init__(
            {
                ("arm", "q"): Unbounded((2,)),
                ("arm", "hand", "goal"): Unbounded((2,)),
                "flat.name": Unbounded((2,)),
            }
        )


def back(goal):
    return 0.25 - goal


def configured(**changes):
    config = compose(["env=insertion-sim"]) | {"env": yaml.safe_load(ENV)} | changes
    assembly.check(config)
    return config


@pytest.mark.parametrize("controller", [BACK, TRACK])
def test_nested_entries_are_read(controller):
    config = configured(controller=yaml.safe_load(controller))
    environment = assembly.environment(config)
    env = environment.make(1)
    reads = interface_of(environment, env)
    assert list(reads.inputs) == [("arm", "q"), "flat.name"]
    assert list(reads.critic_inputs) == [("arm", "q"), ("arm", "hand", "goal")]
    assert reads.inputs["arm", "q"].shape == (4,)
    with torch.no_grad():
        env.rollout(3, assembly.agent(config)(**reads.arguments()).policy)


def test_a_nested_entry_that_is_not_there_is_named_as_yaml_writes_it():
    config = configured(controller=yaml.safe_load(BACK))
    config["env"]["inputs"] = {"arm.hand": {}}
    with pytest.raises(KeyError, match=r"which are arm\.hand\.goal, arm\.q, .*, got 'arm\.hand'"):
        assembly.environment(config).make(1)


def sum_of(**wrong):
    node = {"_target_": "rrl.controllers.SumController"}
    return node | {"controllers": [yaml.safe_load(BACK), yaml.safe_load(BACK) | wrong]}


def test_a_sum_of_controllers_is_configured():
    env = assembly.environment(configured(controller=sum_of())).make(1)
    td = env.reset()
    torch.testing.assert_close(td["base_action"], 0.5 - 2.0 * td["arm", "hand", "goal"])


WRONG = {"_target_": "rrl.controllers.ZeroController", "gian": 1.0}


@pytest.mark.parametrize(
    ("controller", "where"),
    [
        (sum_of(**WRONG), "controllers.1"),
        ({"_target_": f"{__name__}.back", "goal": {"list": [WRONG]}}, "goal.list.0"),
    ],
)
def test_a_target_at_any_depth_is_checked(controller, where):
    config = compose(["env=insertion-sim"]) | {"controller": controller}
    with pytest.raises(ValueError, match=rf"controller\.{where}: .* does not take 'gian'"):
        assembly.check(config)
