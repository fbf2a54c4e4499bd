"""What has to be known of a robot to drive it: four calls and a description."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rrl.signals import held_back, raised_as_exits


class RobotFault(Exception):
    """The robot does not do what it should: it is silent, frozen, or refuses.

    Whoever drives it stops it. Evaluations and collection in real time then try to go on with a
    reset; a run that collects in turn ends. An evaluated episode that ends so in each of three
    attempts counts as failed.
    """


class EntrySpec(NamedTuple):
    """Shape and NumPy type (``float32``, ``bool``) of one entry of an observation."""

    shape: tuple[int, ...]
    dtype: str = "float32"


class Observation(NamedTuple):
    """What a robot measures at one moment.

    Attributes:
        entries: Arrays by name, as the description says.
        time: When they were measured, by any clock of the robot's [s]. A time that does not advance
            from one control step to the next tells of a frozen robot.
    """

    entries: Mapping[str, NDArray[Any]]
    time: float


@dataclass(frozen=True)
class Description:
    """What a robot measures and takes.

    Attributes:
        entries: Every entry of an observation. ``reward`` is one of them, one number; there may be
            ``success``, ``terminated`` and ``truncated``, flags, and names with a slash,
            ``metrics/NAME`` and ``reward_terms/NAME``, one number each.
        low: Smallest command, one number for each dimension.
        high: Largest command.
        period: Seconds from one command to the next.
    """

    entries: Mapping[str, EntrySpec]
    low: tuple[float, ...]
    high: tuple[float, ...]
    period: float

    def within_bounds(self, action: ArrayLike) -> NDArray[Any]:
        """Return a command [n] as a driver may get it: a copy of ``action``, within the bounds.

        Raises:
            RobotFault: If a number of it is not finite.
            ValueError: If it does not have one number for each dimension.
        """
        given = np.asarray(action)
        if given.shape != np.shape(self.low):
            raise ValueError(
                f"action: expected the shape {np.shape(self.low)}, got {given.shape}; give one "
                "number for each dimension of the description's bounds"
            )
        if not np.isfinite(given).all():
            raise RobotFault(f"action: expected finite numbers, got {given.tolist()}")
        # The bounds in the command's own precision: what lies within them stays as it is.
        dtype = np.result_type(given, np.float32)
        low, high = (np.asarray(bound, dtype) for bound in (self.low, self.high))
        return np.clip(given.astype(dtype), low, high)


class Robot(ABC):
    """Four calls by which anybody's robot can be driven.

    No call may take longer than a fraction of the control period, but for :meth:`reset`. Each
    raises :class:`RobotFault` if the robot does not do what it should. A robot that may move on its
    own has to stop by itself a few periods after the last command: nothing else stops it when the
    process that drives it is killed.

    Attributes:
        description: What the robot measures and takes.
    """

    description: Description

    @abstractmethod
    def observe(self) -> Observation:
        """Return what is measured now."""

    @abstractmethod
    def command(self, action: NDArray[Any]) -> None:
        """Execute ``action`` [n], within the description's bounds, from now on."""

    @abstractmethod
    def reset(self, seed: int | None = None) -> None:
        """Go to the start of an episode, and return when it is reached.

        Args:
            seed: Of what is random about the start; a robot that draws nothing ignores it.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stand still, at once."""

    def close(self) -> None:  # noqa: B027 - most have nothing to close
        """Give back what the driver holds."""


def in_type(name: str, given: NDArray[Any], dtype: str) -> NDArray[Any]:
    """Return a measurement in the type of its entry, a copy; infinite where a float is too large.

    Raises:
        ValueError: If it holds no real numbers, or a whole number or a flag would be another one.
    """
    if given.dtype.kind not in "biuf":
        raise ValueError(f"{name}: expected {dtype}, got {given.dtype}")
    with np.errstate(all="ignore"):  # what does not fit is found below
        array = np.array(given, dtype=dtype, order="C")
    if array.dtype.kind != "f" and array.dtype != given.dtype and (array != given).any():
        raise ValueError(f"{name}: expected numbers that {dtype} holds, got {given.tolist()}")
    return array


@contextmanager
def stopping(robot: Robot) -> Iterator[None]:
    """Tell a robot to stop when the block ends, however it ends.

    Also by SIGTERM or a closed terminal (:func:`rrl.signals.raised_as_exits`); further signals wait
    until it was told. SIGKILL and a loss of power are left to the robot's own timeout.
    """
    with raised_as_exits():
        try:
            yield
        finally:
            with held_back():
                robot.stop()
