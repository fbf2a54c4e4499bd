"""The plant moves by itself, and tells by faults what it does not do."""

import importlib
import sys
import time
from functools import partial

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from plants import an_address, plant
from rrl.envs import RobotEnv
from rrl.envs.insertion.config import make_config
from rrl.envs.plant import RemoteRobot, SimulatedPlant, inject
from rrl.robot import RobotFault


@pytest.fixture(scope="module")
def address():
    where = an_address()
    with plant(where):
        yield where


@pytest.fixture
def env(address):
    env = RobotEnv(partial(RemoteRobot, address, patience=5.0), episode_steps=5)
    yield env
    env.close()


@pytest.fixture
def hasty(address):
    """One that waits for no answer longer than a fault lasts."""
    env = RobotEnv(partial(RemoteRobot, address, patience=0.2), episode_steps=5)
    yield env
    env.close()


def step(env, td, action=0.0):
    td["action"] = torch.full((3,), action)
    return env.step(td)["next"].exclude("reward")


def wait_until_it_is_back(env):
    """Reset it until it steps again, as whoever trains does."""
    end = time.monotonic() + 60
    while True:
        try:
            return step(env, env.reset())
        except RobotFault:
            assert time.monotonic() < end


def test_entries_bounds_and_period_are_the_plants(env):
    check_env_specs(env)
    assert env.control_period == pytest.approx(0.05)
    assert env.action_spec.shape == (3,)
    assert {"end_effector_position", "blocks", "goal", "success"} <= set(
        env.observation_spec.keys()
    )
    assert "contact_force" in set(env.observation_spec["metrics"].keys())


def test_an_episode_lasts_its_steps_in_wall_clock_time(env):
    start = time.monotonic()
    td = env.reset()
    for n in range(5):
        td = step(env, td)
        assert bool(td["truncated"]) == (n == 4)
    assert time.monotonic() - start >= 5 * 0.05


def test_it_holds_the_last_command_and_then_stops():
    robot = SimulatedPlant(make_config("sim"), timeout=0.2)
    robot.reset(0)

    def height():
        return float(robot.observe().entries["end_effector_position"][2])

    start = height()
    robot.command(np.array([0.0, 0.0, -0.5]))
    time.sleep(0.15)
    held = height()
    assert held < start - 0.008  # more than the one command's share of a period
    time.sleep(0.3)
    stopped = height()
    time.sleep(0.2)
    assert height() == pytest.approx(stopped, abs=5e-4)


@pytest.mark.parametrize("velocity", [np.nan, 1e15])
def test_physics_that_diverges_truncates_with_the_last_finite_observation(
    velocity, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    robot = SimulatedPlant(make_config("sim"))
    time.sleep(0.02)
    before = robot.observe().entries
    robot._data.qvel[0] = velocity
    time.sleep(0.02)
    after = robot.observe().entries
    assert after["diverged"].all()
    assert after["truncated"].all()
    np.testing.assert_allclose(after["blocks"], before["blocks"], atol=1e-3)
    robot.reset(0)
    assert not robot.observe().entries["truncated"].any()
    assert list(tmp_path.iterdir()) == []


def test_equal_seeds_give_equal_starts(env):
    starts = []
    for _ in range(2):
        env.set_seed(7)
        starts.append(env.reset()["blocks"])
    torch.testing.assert_close(*starts, atol=1e-3, rtol=0)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("freeze", "frozen: expected an observation after"),
        ("nan", "expected finite numbers"),
    ],
)
def test_a_fault_is_named(env, address, kind, message):
    td = env.reset()
    inject(address, kind, 1.0)
    with pytest.raises(RobotFault, match=message):
        for _ in range(5):
            td = step(env, td)
    wait_until_it_is_back(env)


@pytest.mark.parametrize("kind", ["drop", "delay"])
def test_a_late_answer_is_none(hasty, address, kind):
    td = hasty.reset()
    inject(address, kind, 1.0)
    with pytest.raises(RobotFault, match=r"expected an answer to .* got none"):
        step(hasty, step(hasty, td))
    wait_until_it_is_back(hasty)


def test_a_reset_may_be_refused(env, address):
    inject(address, "refuse", 1.0)
    with pytest.raises(RobotFault, match="reset refused: told to"):
        env.reset()
    wait_until_it_is_back(env)


@pytest.mark.slow
def test_a_plant_that_died_is_silent_and_a_new_one_is_found():
    where = an_address()
    with plant(where) as process:
        env = RobotEnv(partial(RemoteRobot, where, patience=2.0))
        td = env.reset()
        inject_death(where, process)
        with pytest.raises(RobotFault, match="got none"):
            step(env, td)
    with plant(where):
        step(env, env.reset())
        env.close()


def inject_death(where, process):
    with pytest.raises(RobotFault):
        inject(where, "die")
    assert process.wait() == 1


def test_what_is_no_fault_is_refused(address):
    with pytest.raises(RobotFault, match="kind: expected one of drop, delay"):
        inject(address, "sulk")


def test_without_its_packages_the_extra_is_named(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("rrl.envs.plant")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "zmq", None)
    with pytest.raises(ModuleNotFoundError, match=r"pip install -e '\.\[realtime\]'"):
        importlib.import_module("rrl.envs.plant")
