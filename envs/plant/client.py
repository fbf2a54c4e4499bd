"""A robot in another process, behind a socket."""

from __future__ import annotations

import time
import uuid
from typing import Any

import zmq
from numpy.typing import NDArray

from rrl.robot import Observation, Robot, RobotFault

from .protocol import ADDRESS, pack, to_description, unpack

ATTEMPTS, LONGEST = 4, 1.0
"""How often a call without an answer is sent, and after how many seconds at the latest it is sent
again: a packet may be lost."""

STOP_PATIENCE = 1.0
"""Seconds for which a robot is told to stop until it answers."""


class RemoteRobot(Robot):
    """The four calls over a socket, to what :func:`~rrl.envs.plant.serve` serves.

    Every call is answered. A call without an answer is sent again within its patience, and counts
    once, however often it arrives, and not at all after a later one: a command that was on its way
    for too long moves no robot that was told to stop since.

    Args:
        address: Where the robot listens, a ZeroMQ address.
        patience: How long an answer may take [s], but to ``stop``, which is said for a second;
            None: 0.4 of the control period.
        reset_patience: How long the way to the start of an episode may take [s].
        connect_patience: How long the robot may take to describe itself [s].

    Raises:
        RobotFault: If an answer takes longer, or the robot refuses.
        ValueError: If the address is none.
    """

    def __init__(
        self,
        address: str = ADDRESS,
        patience: float | None = None,
        reset_patience: float = 30.0,
        connect_patience: float = 30.0,
    ) -> None:
        self.address = address
        self._context = zmq.Context()
        self._name, self._number = uuid.uuid4().hex, 0  # the same in every connection
        try:
            self._connect()
            described = self.ask("describe", connect_patience)
        except BaseException:
            self.close()
            raise
        self.description = to_description(described["description"])
        self._patience = 0.4 * self.description.period if patience is None else patience
        self._reset_patience = reset_patience

    def observe(self) -> Observation:
        """Return what is measured now."""
        answer = self.ask("observe", self._patience)
        return Observation(answer["entries"], answer["time"])

    def command(self, action: NDArray[Any]) -> None:
        """Execute ``action`` [n] from now on."""
        self.ask("command", self._patience, action=action)

    def reset(self, seed: int | None = None) -> None:
        """Go to the start of an episode."""
        self.ask("reset", self._reset_patience, seed=seed)

    def stop(self) -> None:
        """Stand still."""
        self.ask("stop", STOP_PATIENCE)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close(0)
        self._context.term()

    def ask(self, call: str, patience: float, **content: Any) -> dict[str, Any]:
        """Send a call and return its answer.

        Raises:
            RobotFault: If there is none in time, or it is a refusal.
        """
        self._number += 1
        message = pack({"client": self._name, "number": self._number, "call": call, **content})
        ends = time.monotonic() + patience
        again = min(patience / ATTEMPTS, LONGEST)
        while (now := time.monotonic()) < ends:
            self._send(message)
            if (answer := self._receive(min(now + again, ends))) is not None:
                if "refused" in answer:
                    raise RobotFault(f"{call} refused: {answer['refused']}")
                return answer
        self._socket.close(0)  # with everything that is still on its way
        self._connect()
        remedy = "; start what listens there (python -m rrl.envs.plant)"
        raise RobotFault(
            f"{self.address}: expected an answer to {call} within {1e3 * patience:.0f} ms, got none"
            + (remedy if call == "describe" else "")
        )

    def _connect(self) -> None:
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.setsockopt(zmq.RECONNECT_IVL, 20)  # ms; the default backs off
        try:
            self._socket.connect(self.address)
        except zmq.ZMQError as error:
            raise ValueError(
                f"address: expected one such as {ADDRESS} or tcp://HOST:5555, got "
                f"{self.address!r}: {error}"
            ) from error

    def _send(self, message: bytes) -> None:
        try:
            self._socket.send(message, zmq.NOBLOCK)
        except zmq.Again:
            return  # its queue is full: nobody reads, and nobody will answer

    def _receive(self, until: float) -> dict[str, Any] | None:
        while (left := until - time.monotonic()) > 0:
            if self._socket.poll(max(1, round(1e3 * left))):
                answer = unpack(self._socket.recv())
                if answer["number"] == self._number:  # else it came too late for an earlier call
                    return answer
        return None
