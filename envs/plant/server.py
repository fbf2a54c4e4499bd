"""Any robot behind a socket."""

from __future__ import annotations

import logging
import socket as sockets
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from typing import Any

import zmq

from rrl.robot import Robot, RobotFault, stopping

from .faults import DELAY, Faults
from .protocol import ADDRESS, pack, unpack

log = logging.getLogger(__name__)


def serve(
    robot: Robot,
    address: str = ADDRESS,
    *,
    tick: Callable[[], float] = lambda: 0.1,
    running: Callable[[], bool] = lambda: True,
    faults: Faults | None = None,
) -> None:
    """Answer calls of :class:`~rrl.envs.plant.RemoteRobot` until ``running`` returns False.

    However it ends, the robot is told to stop (:func:`~rrl.robot.stopping`). Whatever its driver
    raises refuses the call, and so does a command that is not finite; others are clipped to the
    description's bounds.

    Args:
        robot: Whom the calls are for; it is closed at the end.
        address: Where to listen, a ZeroMQ address.
        tick: Called between calls; returns after how many seconds at most it wants to be called
            again.
        running: Whether to go on, asked after every call and tick.
        faults: What it may be told to do wrong, for tests; None: nothing.

    Raises:
        OSError: If somebody listens at the address already, or it is none.
    """
    with closing(robot), zmq.Context() as context, context.socket(zmq.ROUTER) as socket:
        socket.linger = 0
        _bind(socket, address)
        desk = _Desk(robot, socket, faults)
        with stopping(robot):
            while running():
                wait = min(tick(), desk.send_due())
                if socket.poll(max(0, int(1e3 * wait))):
                    tick()  # what is measured is of the moment of the call
                    desk.answer(*socket.recv_multipart())


def _bind(socket: zmq.Socket[bytes], address: str) -> None:
    kind, _, path = address.partition("://")
    try:
        if kind == "ipc":  # ZeroMQ takes one over from whoever listens there, without a word
            with sockets.socket(sockets.AF_UNIX) as probe:
                if probe.connect_ex(path) == 0:
                    raise OSError("somebody listens there")
        socket.bind(address)
    except (OSError, zmq.ZMQError) as error:
        raise OSError(
            f"address: expected a free one, such as {ADDRESS} or tcp://*:5555, got {address!r}: "
            f"{error}; choose another, or end what listens there"
        ) from error


class _Desk:
    """Reads calls and writes answers."""

    def __init__(
        self, robot: Robot, socket: zmq.Socket[bytes], faults: Faults | None = None
    ) -> None:
        self.robot, self.socket = robot, socket
        self.faults, self._may_fail = faults or Faults(), faults is not None
        self._answered: dict[str, tuple[int, bytes]] = {}  # the last call of each client
        self._late: deque[tuple[float, bytes, bytes]] = deque()

    def answer(self, connection: bytes, *packet: bytes) -> None:
        """Do what a call says, once, and answer it; a packet that is none is dropped.

        So is a call that comes after a later one of the same client: connections overtake others.
        """
        try:
            (data,) = packet
            call = unpack(data)
            client, number, name = str(call["client"]), int(call["number"]), str(call["call"])
        except Exception as error:  # anybody may send anything
            log.warning("a packet is dropped: expected a call of RemoteRobot's, got %r", error)
            return
        last = self._answered.get(client, (0, b""))
        if self.faults.active("drop") or number < last[0]:
            return
        if number > last[0]:
            last = number, self._perform(number, name, call)
            self._answered[client] = last
        if self.faults.active("delay") and name != "fault":
            self._late.append((time.monotonic() + DELAY, connection, last[1]))
        else:
            self.socket.send_multipart([connection, last[1]])

    def send_due(self) -> float:
        """Send delayed answers whose time has come; return the seconds to the next."""
        while self._late and self._late[0][0] <= time.monotonic():
            _, connection, answer = self._late.popleft()
            self.socket.send_multipart([connection, answer])
        return self._late[0][0] - time.monotonic() if self._late else 0.1

    def _perform(self, number: int, name: str, call: dict[str, Any]) -> bytes:
        """Do what a call says; return the answer."""
        try:
            return pack({"number": number, **self._ask(name, call)})
        except (RobotFault, ValueError) as error:
            reason = str(error)
        except Exception as error:  # of a driver, which anybody may have written
            log.exception("%s failed", name)
            reason = f"{type(error).__name__}: {error}"
        return pack({"number": number, "refused": reason})

    def _ask(self, name: str, call: dict[str, Any]) -> dict[str, Any]:
        if name == "observe":
            return self._observe()
        if name == "describe":
            return {"description": vars(self.robot.description)}
        if name == "command":
            self.robot.command(self.robot.description.within_bounds(call["action"]))
        elif name == "reset":
            if self.faults.active("refuse"):
                raise RobotFault("told to")
            self.robot.reset(call["seed"])
        elif name == "stop":
            self.robot.stop()
        elif name == "fault" and self._may_fail:
            self.faults.begin(call["kind"], call["seconds"])
        else:
            raise RobotFault(f"expected observe, command, reset or stop, got {name!r}")
        return {}

    def _observe(self) -> dict[str, Any]:
        frozen = self.faults.active("freeze")
        if not frozen or not hasattr(self, "_seen"):
            self._seen = self.robot.observe()
        return {"entries": self.faults.spoil(dict(self._seen.entries)), "time": self._seen.time}
