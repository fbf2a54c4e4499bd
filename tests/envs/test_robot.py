"""A robot's description is an environment's specs, whatever NumPy calls its types."""

import os
import signal

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from rrl.envs import RobotEnv
from rrl.robot import Description, EntrySpec, Observation, Robot, RobotFault
from rrl.trainers.requests import stand_still


class Described(Robot):
    """Measures ones, of whatever shape and type it says; its first step is the last."""

    def __init__(self, **entries):
        entries = {"reward": EntrySpec((1,)), **entries}
        self.description = Description(entries, (-1.0,), (1.0,), period=0.001)
        self._clock = 0.0

    def observe(self):
        self._clock += 1.0
        described = self.description.entries.items()
        entries = {name: np.ones(shape, dtype) for name, (shape, dtype) in described}
        if "terminated" in entries:
            entries["terminated"][...] = self._moves
        return Observation(entries, self._clock)

    def command(self, action):
        self._moves = True

    def reset(self, seed=None):
        self._moves = False

    def stop(self):
        pass


@pytest.mark.parametrize(
    "entries",
    [
        {"success": EntrySpec((), "bool"), "terminated": EntrySpec((), "bool")},
        {"terminated": EntrySpec((1, 1), "bool")},
        {"reward": EntrySpec((), "float64")},
        {"reward": EntrySpec((1, 1), "int32")},
        {"position": EntrySpec((2,), "<f4"), "height": EntrySpec((), ">f8")},
        {"position": EntrySpec([2, 3])},
    ],
)
def test_one_number_may_have_no_shape_and_types_go_by_any_name(entries):
    env = RobotEnv(Described(**entries))
    check_env_specs(env)
    following = env.rollout(1)["next"]
    assert following["reward"].tolist() == [[1.0]]
    assert following["terminated"].item() == ("terminated" in entries)
    for name, (shape, dtype) in entries.items():
        if name not in ("reward", "terminated"):
            assert following[name].shape == (1, *(shape or (1,)))
            assert following[name].numpy().dtype == np.dtype(dtype).newbyteorder("=")
    env.close()


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"reward": EntrySpec((3,))}, r"expected 'reward' to be one number, got \(3,\)"),
        ({"truncated": EntrySpec((2,), "bool")}, "expected 'truncated' to be one number"),
        ({"name": EntrySpec((1,), "U8")}, "expected 'name' of a type that .* got 'U8'"),
        ({"name": EntrySpec((1,), "number")}, "expected 'name' of a type that .* got 'number'"),
    ],
)
def test_an_entry_that_cannot_be_is_named(entries, message):
    with pytest.raises(ValueError, match=rf"description\.entries: {message}"):
        RobotEnv(Described(**entries))


class WritesIntoItsCommand(Described):
    """Scales what it is told in place, as drivers do."""

    def command(self, action):
        action *= 0.1
        super().command(action)


def test_what_a_driver_writes_into_its_command_reaches_nobody_else():
    env = RobotEnv(WritesIntoItsCommand())
    td = env.reset().set("action", torch.ones(1))
    assert env.step(td)["action"].item() == 1.0


class Commanded(Described):
    """Notes what it is told."""

    def __init__(self):
        super().__init__()
        self.description = Description(self.description.entries, (-0.1, 0.0), (0.1, 2.0), 0.001)
        self.commands = []

    def command(self, action):
        self.commands.append(action)
        super().command(action)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_driver_is_commanded_within_its_bounds(dtype):
    env = RobotEnv(Commanded())
    for action in ([5.0, -5.0], [0.05, 1.5], [0.1, 2.0]):
        env.step(env.reset().set("action", torch.tensor(action, dtype=dtype)))
    clipped, *within = (torch.from_numpy(command) for command in env.robot.commands)
    assert torch.equal(clipped, torch.tensor([0.1, 0.0], dtype=dtype))
    assert torch.equal(torch.stack(within), torch.tensor([[0.05, 1.5], [0.1, 2.0]], dtype=dtype))


@pytest.mark.parametrize("number", [float("nan"), float("inf"), float("-inf")])
def test_what_is_not_finite_is_never_commanded(number):
    env = RobotEnv(Commanded())
    td = env.reset().set("action", torch.tensor([0.0, number]))
    with pytest.raises(RobotFault, match=r"action: expected finite numbers, got \[0\.0, .*\]"):
        env.step(td)
    assert env.robot.commands == []


class SaysNothing(Described):
    def __init__(self):
        pass


class Measures(Described):
    """Returns something else than an observation."""

    def __init__(self, measured):
        super().__init__()
        self._measured = measured

    def observe(self):
        return self._measured


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (object(), r"robot: expected an rrl\.robot\.Robot.*, got a object"),
        (dict, r"robot: expected an rrl\.robot\.Robot.*, got a dict"),
        (SaysNothing, "robot: expected a SaysNothing with a description.*, got None"),
    ],
)
def test_what_is_no_robot_is_refused(robot, message):
    with pytest.raises(TypeError, match=message):
        RobotEnv(robot)


@pytest.mark.parametrize(("low", "high"), [((1.0,), (-1.0,)), ((-1.0,), (1.0, 1.0)), (-1.0, 1.0)])
def test_bounds_that_cannot_be_are_refused(low, high):
    robot = Described()
    robot.description = Description(robot.description.entries, low, high, period=0.001)
    with pytest.raises(ValueError, match=r"description: expected low and high, .* no more than"):
        RobotEnv(robot)


@pytest.mark.parametrize("measured", [{"reward": np.ones(1)}, None])
def test_what_is_no_observation_is_refused(measured):
    with pytest.raises(TypeError, match=r"observe\(\): expected an rrl\.robot\.Observation, got"):
        RobotEnv(Measures(measured)).reset()


@pytest.mark.parametrize(
    ("dtype", "measured", "error", "message"),
    [
        (
            "int16",
            [40000],
            ValueError,
            r"measured: expected numbers that int16 holds.*\[40000\]",
        ),
        (
            "uint8",
            [-1.0],
            ValueError,
            r"measured: expected numbers that uint8 holds.*\[-1\.0\]",
        ),
        ("bool", [0.7], ValueError, r"measured: expected numbers that bool holds.*\[0\.7\]"),
        ("bool", [np.nan], RobotFault, r"measured: expected finite numbers, got \[nan\]"),
        ("int64", [np.nan], RobotFault, r"measured: expected finite numbers, got \[nan\]"),
        ("float32", [1e39], RobotFault, r"measured: expected finite numbers, got \[1e\+39\]"),
        ("bool", [1.0], None, [True]),
        ("int16", [3.0], None, [3]),
        ("float32", [3], None, [3.0]),
    ],
)
def test_what_is_measured_is_what_an_entry_holds_or_refused(dtype, measured, error, message):
    robot = Measures(Observation({"reward": np.ones(1), "measured": np.array(measured)}, 0.0))
    robot.description = Described(measured=EntrySpec((1,), dtype)).description
    env = RobotEnv(robot)
    if error is None:
        assert env.reset()["measured"].tolist() == message
    else:
        with pytest.raises(error, match=message):
            env.reset()


@pytest.mark.parametrize("made_here", [True, False])
def test_a_robot_that_was_made_for_an_environment_that_cannot_be_is_closed(made_here):
    robot, closed = Described(), []
    robot.description = Description(robot.description.entries, (1.0,), (-1.0,), period=0.001)
    robot.close = lambda: closed.append(robot)
    with pytest.raises(ValueError, match="description"):
        RobotEnv((lambda: robot) if made_here else robot)
    assert closed == [robot] * made_here


class Interrupted(Described):
    """Somebody presses Ctrl-C while it is told to stop."""

    def __init__(self):
        super().__init__()
        self.has_stopped = self.is_closed = False

    def stop(self):
        if not self.has_stopped:
            os.kill(os.getpid(), signal.SIGINT)
        self.has_stopped = True

    def close(self):
        self.is_closed = True


@pytest.mark.parametrize("end", [RobotEnv.close, stand_still])
def test_a_signal_waits_until_the_robot_was_told_to_stop(end):
    robot = Interrupted()
    env = RobotEnv(robot)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            end(env)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert robot.has_stopped
    env.close()
    assert robot.is_closed
