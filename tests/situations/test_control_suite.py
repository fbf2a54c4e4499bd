"""Tasks of the dm_control suite through TorchRL, some with single numbers of shape ()."""

from functools import partial

import pytest
from torchrl.envs import DMControlEnv

import rrl.envs.opengl  # noqa: F401 - MuJoCo without OpenGL

TASKS = {
    "pendulum-swingup": ["orientation", "velocity"],
    "cheetah-run": ["position", "velocity"],
    "cartpole-swingup": ["position", "velocity"],
    "hopper-hop": ["position", "velocity", "touch"],
    "walker-stand": ["orientations", "height", "velocity"],
    "manipulator-bring_ball": ["arm_pos", "arm_vel", "touch", "hand_pos", "object_pos"],
}
OTHERS = {"cheetah-run", "cartpole-swingup", "hopper-hop"}
"""Alike, for the code under test, to those that stay."""


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(
    "name",
    [pytest.param(task, marks=pytest.mark.slow if task in OTHERS else ()) for task in TASKS],
)
def test_a_task_is_trained(check_run, factory, name):
    domain, task = name.split("-")
    environment = factory(partial(DMControlEnv, domain, task), TASKS[name])
    _, _, stored = check_run(environment)
    spec = DMControlEnv(domain, task).observation_spec
    assert {k: stored[k].shape[1:] for k in TASKS[name]} == {k: spec[k].shape for k in TASKS[name]}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_two_side_by_side_with_an_entry_of_one_number(check_run, factory):
    environment = factory(partial(DMControlEnv, "walker", "stand"), ["height", "velocity"])
    _, _, stored = check_run(environment, num_envs=2, steps_per_collection=10)
    assert stored["height"].shape[1:] == (1,)  # () in dm_control
    assert not stored["height"].eq(stored["next", "height"]).all()
