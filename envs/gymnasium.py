"""Any Gymnasium environment as a TorchRL environment that reports its success."""

from __future__ import annotations

from collections import UserDict
from collections.abc import Callable
from typing import Any

import torch
from torchrl.data import Binary, Composite
from torchrl.envs import GymWrapper
from torchrl.envs.gym_like import default_info_dict_reader

from rrl.keys import SUCCESS


def gymnasium_env(
    make: str | Callable[..., Any],
    *,
    success: str | Callable[[Any], Any] | None = None,
    any_time: bool = False,
    seed: Callable[[Any, int], Any] | None = None,
    state: Callable[[Any], Any] | None = None,
    max_episode_steps: int | None = None,
    **arguments: Any,
) -> GymWrapper:
    """Return a Gymnasium environment with ``batch_size []`` as a TorchRL environment.

    Entries of a dictionary keep their names (``observation``, ``achieved_goal``, ``desired_goal``);
    any other observation is called ``observation``. The action is called ``action``.

    Args:
        make: A registered name, or a function that makes the environment.
        success: Says whether the task is solved in this state: the name of an entry of a step's
            ``info``, often ``success`` or ``is_success``, or a function of the environment that
            ``make`` gave. It becomes ``success`` [1], bool; where ``info`` lacks it, False.
        any_time: Success stays until the next reset: an episode counts as solved if any of its
            states was. Otherwise the last one decides.
        seed: Seeds the environment, called as ``seed(env, number)`` before a reset with a seed; for
            one whose ``reset`` ignores its seed.
        state: What a video's renderer needs of this moment, an array: a function of the environment
            behind ``physics_state()``. None: MuJoCo's, for :func:`~rrl.envs.render_mujoco`.
        max_episode_steps: Truncates episodes after so many steps.
        arguments: Of ``gymnasium.make`` or of ``make``.

    Raises:
        ImportError: If Gymnasium is not installed.
        TypeError: If ``make`` is an environment already, or gives no Gymnasium environment or a
            vector of them.
        KeyError: If an episode ends whose ``info`` never had the entry that ``success`` names.
    """
    try:
        import gymnasium

        from .gymnasium_reports import Reporting
    except ImportError as error:
        raise ImportError("a Gymnasium environment needs: pip install gymnasium") from error
    env = limited = _made(make, max_episode_steps, arguments)
    if max_episode_steps is not None and not isinstance(make, str):
        limited = gymnasium.wrappers.TimeLimit(env, max_episode_steps)
    wrapped = _Named(Reporting(limited, env, success, any_time, seed, state))
    if success is not None:
        flag = Binary(1, (1,), dtype=torch.bool)
        wrapped.set_info_dict_reader(default_info_dict_reader([SUCCESS], {SUCCESS: flag}))
    return wrapped


def _made(make: Any, max_episode_steps: int | None, arguments: dict[str, Any]) -> Any:
    """Return the one environment that ``make`` gives; see :func:`gymnasium_env`."""
    import gymnasium

    if isinstance(make, gymnasium.Env) or not (isinstance(make, str) or callable(make)):
        got = "an environment" if hasattr(make, "step") else f"a {type(make).__name__}"
        raise TypeError(
            f"make: expected a name or a function that makes it, got {got}; every slot has an "
            "environment of its own"
        )
    if isinstance(make, str):
        env = gymnasium.make(make, max_episode_steps=max_episode_steps, **arguments)
    else:
        env = make(**arguments)
    if not isinstance(env, gymnasium.Env):
        remedy = "; batching: serial or parallel runs copies" if hasattr(env, "num_envs") else ""
        raise TypeError(f"make: expected one gymnasium.Env, got a {type(env).__name__}{remedy}")
    return env


class _Named(GymWrapper):
    """Leaves entries called ``state`` their name, where TorchRL makes it ``observation``."""

    def _make_specs(self, env: Any, batch_size: Any = None) -> None:
        super()._make_specs(env, batch_size)
        spec = super().observation_spec
        _rename_states(spec, env.observation_space)
        self.observation_spec = spec

    def read_obs(self, observations: Any) -> dict[str, Any]:
        """Read an observation; TorchRL renames the entries of a ``dict`` alone."""
        named = UserDict(observations) if isinstance(observations, dict) else observations
        return dict(super().read_obs(named))


def _rename_states(spec: Composite, space: Any) -> None:
    """Give the entries ``state`` of a space and of the spaces in it their names back."""
    entries = getattr(space, "spaces", None)
    if not isinstance(entries, dict):
        return
    if "state" in entries and "observation" not in entries:
        spec["state"] = spec["observation"]
        del spec["observation"]
    for name, inner in entries.items():
        _rename_states(spec[name], inner)
