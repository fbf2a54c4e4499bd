"""Anybody's robot as a TorchRL environment in wall-clock time."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, TensorSpec, Unbounded
from torchrl.envs import EnvBase

from rrl.keys import ACTION, REWARD
from rrl.pace import Pace
from rrl.robot import Description, EntrySpec, Observation, Robot, RobotFault, in_type
from rrl.signals import held_back

log = logging.getLogger(__name__)

FLAGS = ("terminated", "truncated")


class RobotEnv(EnvBase):
    """A :class:`~rrl.robot.Robot` with ``batch_size []``, driven at its own control period.

    A step commands, waits for the end of the period (:class:`~rrl.pace.Pace`) and observes. What is
    commanded is clipped to the description's bounds. Once told to stop, the robot gets no command
    before its next reset: a step then ends the episode.
    Entries, bounds and period are those of the robot's description.

    Reads ``action``; writes the description's entries under their names (those with a slash
    nested; one number is [1]), ``reward`` [1], ``done``, ``terminated`` and ``truncated`` [1].

    Args:
        robot: The robot, or what makes it.
        episode_steps: Control steps after which an episode is truncated.
        seed: Of the seeds that resets get; None draws one from torch's global generator.

    Attributes:
        pace: When the periods begin, and how late they did.
        control_period: Seconds from one action to the next.

    Raises:
        TypeError: If ``robot`` is or makes no robot with a description, or ``observe()`` returns
            something else than an observation.
        ValueError: If the description has no ``reward``, an entry or bounds that cannot be, or an
            observation is not as described.
        RobotFault: By steps and resets, if the robot is silent, frozen or refuses, or measures what
            is not finite; by a step, if the action is not finite, which is then not commanded.
    """

    makes_new_tensors = True

    def __init__(
        self, robot: Robot | Callable[[], Robot], episode_steps: int = 1000, seed: int | None = 0
    ) -> None:
        super().__init__(device="cpu", batch_size=[])
        self.robot = _made(robot)
        self.description, self.episode_steps = self.robot.description, episode_steps
        self.control_period = self.description.period
        self.pace = Pace(self.control_period)
        self._steps, self._measured_at = 0, float("-inf")
        self._connected, self._stopped = True, False
        try:
            self._make_specs()
        except Exception:
            if self.robot is not robot:  # made here: nobody else can close it
                self.robot.close()
            raise
        self._set_seed(seed)

    def stop(self) -> None:
        """Have the robot stand still until the next reset."""
        self._stopped = True
        self.robot.stop()

    def close(self, **kwargs: Any) -> None:
        """Stop the robot and close its driver, whether or not it answers."""
        if self._connected:
            self._connected = False
            try:
                with held_back():
                    self.robot.stop()
            except RobotFault as fault:
                log.warning("the robot is left without being told to stop: %s", fault)
            finally:
                self.robot.close()
        super().close(**kwargs)

    def _make_specs(self) -> None:
        entries = self._entries = {
            name: _readable(name, *entry) for name, entry in self.description.entries.items()
        }
        if REWARD not in entries:
            raise ValueError(
                f"description.entries: expected {REWARD!r} among them, computed from what is "
                f"measured, got {sorted(entries)}"
            )
        observation = Composite()
        for name, entry in entries.items():
            if name not in (REWARD, *FLAGS):
                observation[tuple(name.split("/"))] = _spec(entry)
        self.observation_spec = observation
        low, high = _bounds(self.description)
        self.action_spec = Bounded(low, high, shape=low.shape, dtype=torch.float32)
        self.reward_spec = Unbounded((1,), dtype=torch.float32)
        self.done_spec = Composite(
            {name: _spec(EntrySpec((1,), "bool")) for name in ("done", *FLAGS)}
        )

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            seed = int(torch.randint(2**31, ()).item())
        self._seeds = np.random.default_rng(seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        self.robot.reset(int(self._seeds.integers(2**31)))
        self._steps, self._measured_at, self._stopped = 0, float("-inf"), False
        self.pace.start()
        return self._read().exclude(REWARD)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        if not self._stopped:
            action = tensordict[ACTION].detach().numpy()
            self.robot.command(self.description.within_bounds(action))
        self.pace.wait()
        self._steps += 1
        return self._read()

    def _read(self) -> TensorDict:
        observation = self.robot.observe()
        entries = self._checked(observation)
        terminated, truncated = (bool(entries.pop(name, False)) for name in FLAGS)
        truncated |= self._stopped or self._steps >= self.episode_steps
        td = TensorDict({}, [])
        for name, value in entries.items():
            td[tuple(name.split("/"))] = value if value.ndim else value.reshape(1)
        td[REWARD] = td[REWARD].float().reshape(1)
        flags = {"terminated": terminated, "truncated": truncated, "done": terminated or truncated}
        return td.update({name: torch.tensor([flag]) for name, flag in flags.items()})

    def _checked(self, observation: Observation) -> dict[str, Any]:
        """Return the described entries as tensors."""
        if not isinstance(observation, Observation):
            raise TypeError(
                f"observe(): expected an rrl.robot.Observation, got a {type(observation).__name__}"
            )
        if observation.time <= self._measured_at:
            raise RobotFault(
                f"frozen: expected an observation after {self._measured_at:.3f} s of the robot's "
                f"clock, got one of {observation.time:.3f} s"
            )
        self._measured_at = observation.time
        entries = {}
        for name, (shape, dtype) in self._entries.items():
            value = observation.entries.get(name)
            if value is None or np.shape(value) != shape:
                got = "none" if value is None else f"the shape {np.shape(value)}"
                raise ValueError(f"observation: expected {name!r} of the shape {shape}, got {got}")
            entries[name] = torch.from_numpy(_measured(name, np.asarray(value), dtype))
        return entries


def _measured(name: str, given: NDArray[Any], dtype: str) -> NDArray[Any]:
    """Return a measurement in its described type; a driver may write into its own again.

    Raises:
        RobotFault: If a number is not finite.
        ValueError: If it does not fit the type.
    """
    lost = given.dtype.kind == "f" and not np.isfinite(given).all()
    array = given if lost else in_type(name, given, dtype)
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise RobotFault(f"{name}: expected finite numbers, got {given.tolist()}")
    return array


def _made(robot: Any) -> Robot:
    made = robot if isinstance(robot, Robot) or not callable(robot) else robot()
    if not isinstance(made, Robot):
        raise TypeError(
            "robot: expected an rrl.robot.Robot, a class derived from it or what makes one, got a "
            f"{type(made).__name__}"
        )
    if not isinstance(getattr(made, "description", None), Description):
        raise TypeError(
            f"robot: expected a {type(made).__name__} with a description, an "
            f"rrl.robot.Description, got {getattr(made, 'description', None)!r}"
        )
    return made


def _bounds(description: Description) -> tuple[Tensor, Tensor]:
    low, high = (
        torch.as_tensor(bound, dtype=torch.float32) for bound in (description.low, description.high)
    )
    if low.ndim != 1 or low.shape != high.shape or (low > high).any():
        raise ValueError(
            "description: expected low and high, a number for each dimension of the action, "
            f"low no more than high, got {description.low} and {description.high}"
        )
    return low, high


def _readable(name: str, shape: Sequence[int], dtype: str) -> EntrySpec:
    """Return a described entry with PyTorch's name for its type.

    Raises:
        ValueError: If it has no such type, or is no single number and has to be.
    """
    shape = tuple(shape)
    if name in (REWARD, *FLAGS) and math.prod(shape) != 1:
        raise ValueError(f"description.entries: expected {name!r} to be one number, got {shape}")
    try:
        kind = np.dtype(dtype).name
        getattr(torch, kind)
    except (TypeError, AttributeError):
        raise ValueError(
            f"description.entries: expected {name!r} of a type that NumPy and PyTorch have, such "
            f"as float32 or bool, got {dtype!r}"
        ) from None
    return EntrySpec(shape, kind)


def _spec(entry: EntrySpec) -> TensorSpec:
    shape = entry.shape or (1,)
    if entry.dtype == "bool":
        return Binary(n=shape[-1], shape=shape, dtype=torch.bool)
    return Unbounded(shape, dtype=getattr(torch, entry.dtype))
