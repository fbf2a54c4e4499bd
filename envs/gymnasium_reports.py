"""What TorchRL does not ask a Gymnasium environment for: its success, its state for videos."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

from rrl.keys import SUCCESS

from .pictures import mujoco_state


class Reporting(gymnasium.Wrapper):
    """Seeds an environment, writes ``success`` into every ``info``, tells the state for videos.

    Args:
        env: What is stepped and reset; ``made`` or a wrapper of it.
        made: The environment that ``success``, ``seed`` and ``state`` are called with.
        success: An entry of ``info``, or a function of ``made``; None: nothing is ever solved.
        any_time: Success stays until the next reset.
        seed: Called as ``seed(made, number)`` before a reset with a seed; None: ``reset`` takes it.
        state: Gives what a video's renderer needs; None: MuJoCo's state.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        made: gymnasium.Env,
        success: str | Callable[[Any], Any] | None,
        any_time: bool,
        seed: Callable[[Any, int], Any] | None,
        state: Callable[[Any], Any] | None,
    ) -> None:
        super().__init__(env)
        self._made, self._success, self._any_time = made, success, any_time
        self._seed, self._state = seed, state or mujoco_state
        self._solved, self._told = False, False

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        """Begin an episode, which is not solved yet."""
        if seed is not None and self._seed is not None:
            self._seed(self._made, seed)
            seed = None
        observation, info = self.env.reset(seed=seed, options=options)
        self._solved, self._told = False, False
        return observation, {**info, SUCCESS: np.array([self._solved])}

    def step(self, action: Any) -> tuple[Any, ...]:
        """Take a step.

        Raises:
            KeyError: If the episode ends and no ``info`` of it had the entry ``success``.
        """
        *outcome, info = self.env.step(action)
        self._solved = self._is_solved(info, ended=any(outcome[2:])) or (
            self._any_time and self._solved
        )
        return (*outcome, {**info, SUCCESS: np.array([self._solved])})

    def physics_state(self) -> Any:
        """Return what a video's renderer needs of this moment."""
        return self._state(self._made)

    def _is_solved(self, info: dict[str, Any], ended: bool) -> bool:
        if not isinstance(self._success, str):
            return self._success is not None and _flag(self._success(self._made))
        self._told = self._told or self._success in info
        if ended and not self._told:
            raise KeyError(
                "success: expected an entry of info by the episode's end, which has "
                f"{sorted(info)}, got {self._success!r}"
            )
        return _flag(info.get(self._success, False))


def _flag(value: Any) -> bool:
    """Return whether a value is 1; NaN and None are not."""
    if not value or value == 1 or value != value:
        return bool(value == 1)
    raise ValueError(
        f"success: expected a flag, 0 or 1, got {value!r}; name an entry of info, or give a "
        "function, that says whether the task is solved"
    )
