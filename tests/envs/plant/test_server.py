"""Whatever is sent to a served robot, and however its driver fails, it goes on, and stops at the end."""

import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from functools import partial

import numpy as np
import pytest
import zmq

from plants import an_address
from rrl.envs.plant import RemoteRobot, serve
from rrl.envs.plant.__main__ import main
from rrl.envs.plant.protocol import pack
from rrl.robot import Description, EntrySpec, Observation, Robot, RobotFault, stopping


class Recorder(Robot):
    """Notes what it is told; its commands fail as they are told to."""

    description = Description({"reward": EntrySpec((1,))}, (-1.0,), (1.0,), 0.05)

    def __init__(self, error=None):
        self.calls, self.error, self.commands = [], error, []

    def observe(self):
        self.calls.append("observe")
        return Observation({"reward": np.zeros(1, np.float32)}, 0.0)

    def command(self, action):
        self.calls.append("command")
        self.commands.append(action)
        if self.error is not None:
            raise self.error

    def reset(self, seed=None):
        self.calls.append("reset")

    def stop(self):
        self.calls.append("stop")

    def close(self):
        self.calls.append("close")


@contextmanager
def served(robot, address):
    """A client of a robot that is served while the body runs."""
    over = threading.Event()
    running = partial(serve, robot, address, tick=lambda: 0.01, running=lambda: not over.is_set())
    server = threading.Thread(target=running)
    server.start()
    client = RemoteRobot(address, patience=10.0)
    try:
        yield client
    finally:
        client.close()
        over.set()
        server.join()


def test_at_the_end_it_is_told_to_stop_and_is_closed():
    robot = Recorder()
    with served(robot, an_address()) as client:
        client.command(np.zeros(1))
    assert robot.calls == ["command", "stop", "close"]


@pytest.mark.parametrize(
    "packet",
    [
        [b"", pack({"client": "I", "number": 1, "call": "stop"})],  # as zmq.REQ sends it
        [b"hello"],
        [b""],
        [pack({"number": 1, "call": "stop"})],
        [pack({"client": "I", "call": "stop"})],
        [pack({"client": "I", "number": "first", "call": "stop"})],
        [pack([1, 2])],
    ],
    ids=["request", "text", "nothing", "nobody", "no number", "no such number", "no call"],
)
def test_a_packet_that_is_no_call_is_dropped(packet):
    robot, address = Recorder(), an_address()
    with (
        served(robot, address) as client,
        zmq.Context() as context,
        context.socket(zmq.DEALER) as stranger,
    ):
        stranger.linger = 0
        stranger.connect(address)
        stranger.send_multipart(packet)
        assert not stranger.poll(100)
        client.command(np.zeros(1))
    assert robot.calls == ["command", "stop", "close"]


def test_a_command_that_arrives_after_a_later_stop_moves_nobody(monkeypatch):
    robot, address = Recorder(), an_address()
    with (
        served(robot, address) as client,
        zmq.Context() as context,
        context.socket(zmq.DEALER) as slow,  # the network's way of the client's first connection
    ):
        slow.linger = 0
        slow.connect(address)
        with monkeypatch.context() as patch:
            on_their_way = []
            patch.setattr(client, "_send", on_their_way.append)
            patch.setattr(client, "_patience", 0.05)
            with pytest.raises(RobotFault, match="expected an answer to command"):
                client.command(np.ones(1))
        client.stop()
        slow.send(on_their_way[0])
        assert not slow.poll(100)
    assert robot.calls == ["stop", "stop", "close"]


def test_whatever_a_driver_raises_refuses_the_call():
    robot = Recorder(OSError("the cable is out"))
    with served(robot, an_address()) as client:
        with pytest.raises(RobotFault, match="command refused: OSError: the cable is out"):
            client.command(np.zeros(1))
        with pytest.raises(RobotFault, match="command refused: KeyError: 'action'"):
            client.ask("command", 10.0)
        with pytest.raises(RobotFault, match="dance refused: expected observe, command"):
            client.ask("dance", 10.0)
        client.observe()
    assert robot.calls == ["command", "observe", "stop", "close"]


def test_a_driver_is_commanded_within_its_bounds_whoever_calls():
    robot = Recorder()
    with served(robot, an_address()) as client:
        client.command(np.full(1, 5.0, np.float32))
        with pytest.raises(RobotFault, match="command refused: action: expected finite numbers"):
            client.command(np.full(1, np.nan))
        with pytest.raises(RobotFault, match=r"command refused: action: expected the shape \(1,\)"):
            client.command(np.zeros(2))
    assert [command.tolist() for command in robot.commands] == [[1.0]]


@pytest.mark.parametrize("address", ["ipc://plant", "nowhere"])
def test_an_address_that_is_taken_or_none_is_refused(address, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a short path
    first, second = Recorder(), Recorder()
    with served(first, "ipc://plant") as client:
        with pytest.raises(OSError, match=f"address: expected a free one.*got '{address}'"):
            serve(second, address)
        client.command(np.zeros(1))
    assert second.calls == ["close"]
    assert first.calls == ["command", "stop", "close"]
    with served(second, "ipc://plant") as client:  # what the first one left behind is free
        client.command(np.zeros(1))


@pytest.mark.parametrize(
    ("address", "error", "message"),
    [
        ("nowhere", ValueError, "address: expected one such as ipc:///tmp/rrl-plant .*'nowhere'"),
        (None, RobotFault, r"describe within 50 ms, got none; start what listens there"),
    ],
)
def test_a_robot_that_is_not_there_is_named_and_leaves_nothing_open(
    address, error, message, monkeypatch
):
    contexts, new = [], zmq.Context
    monkeypatch.setattr(zmq, "Context", lambda: contexts.append(new()) or contexts[-1])
    with pytest.raises(error, match=message):
        RemoteRobot(address or an_address(), connect_patience=0.05)
    assert [context.closed for context in contexts] == [True]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["foo"], "task settings: expected names of"),
        (["substeps=[1"], "expected ',' or ']'"),
        (["substeps=0"], "substeps: expected"),
        (["--address", "foo"], "address: expected a free one"),
    ],
)
def test_the_command_says_what_is_wrong_with_its_arguments(arguments, message, capsys, monkeypatch):
    monkeypatch.setattr("signal.signal", lambda *_: None)
    with pytest.raises(SystemExit):
        main([*arguments, "--priority", "0"])
    assert message in capsys.readouterr().err


PROGRAM = """
import sys
import time
from rrl.envs.plant import serve
from rrl.robot import Description, EntrySpec, Robot

class Loud(Robot):
    description = Description({"reward": EntrySpec((1,))}, (-1.0,), (1.0,), 0.05)
    observe = command = reset = None

    def stop(self):
        print("stops", flush=True)
        time.sleep(0.3)
        print("stopped", flush=True)

    def close(self):
        print("closed", flush=True)

print("ready", flush=True)
serve(Loud(), sys.argv[1])
"""


@pytest.mark.parametrize(
    ("first", "second", "at_once"),
    [
        (signal.SIGTERM, signal.SIGHUP, True),
        pytest.param(signal.SIGTERM, signal.SIGHUP, False, marks=pytest.mark.slow),
        pytest.param(signal.SIGHUP, signal.SIGTERM, False, marks=pytest.mark.slow),
        pytest.param(signal.SIGINT, signal.SIGINT, False, marks=pytest.mark.slow),
    ],
)
def test_signals_that_end_the_program_stop_the_robot_first(first, second, at_once):
    command = [sys.executable, "-c", PROGRAM, an_address()]
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL, "preexec_fn": all_heard}
    with subprocess.Popen(command, **quiet) as program:
        try:
            assert program.stdout.readline() == b"ready\n"
            while not listens(command[-1]):
                assert program.poll() is None
            program.send_signal(first)
            if not at_once:
                assert program.stdout.readline() == b"stops\n"
            program.send_signal(second)
            allowed = {-signal.SIGINT, 128 + first, *([128 + second] if at_once else [])}
            assert program.wait(60) in allowed
            assert program.stdout.read().endswith(b"stopped\nclosed\n")
        finally:
            program.kill()


def all_heard():
    """Put back what a shell that starts the tests in the background, or ``nohup``, has ignored."""
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.signal(number, signal.SIG_DFL)


def listens(address):
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.linger = 0
        socket.connect(address)
        socket.send(pack({"client": "test", "number": 1, "call": "describe"}))
        return socket.poll(200) > 0


def test_a_program_that_has_decided_about_a_signal_keeps_its_handler():
    def decided(*_):
        """Does nothing."""

    before = signal.signal(signal.SIGTERM, decided), signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        with stopping(Recorder()):
            assert signal.getsignal(signal.SIGTERM) is decided
            assert signal.getsignal(signal.SIGHUP) is not signal.SIG_DFL
        assert signal.getsignal(signal.SIGTERM) is decided
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL
    finally:
        for number, handler in zip((signal.SIGTERM, signal.SIGHUP), before, strict=True):
            signal.signal(number, handler)


def test_a_robot_that_is_driven_from_a_thread_is_stopped_too():
    robot = Recorder()

    def drive():
        with stopping(robot):
            robot.command(None)

    thread = threading.Thread(target=drive)
    thread.start()
    thread.join()
    assert robot.calls == ["command", "stop"]
