"""What a learner draws from, and the one that ``rrl train`` uses by default."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

import torch
from torch import Tensor

from rrl.algorithms import Agent

from ..defaults import default_config
from ..environment import EnvironmentFactory

__all__ = ["LearnerGenerator", "build", "default_agent", "default_exploration", "locate"]


class LearnerGenerator:
    """Lets updates draw from numbers of their own, apart from what collecting draws.

    TorchRL's losses and samplers draw from torch's global generator. What is learned from stored
    transitions must not depend on whether they are collected anew or read from the log.

    Args:
        seed: Of the numbers.
    """

    def __init__(self, seed: int) -> None:
        self._state = torch.Generator().manual_seed(seed).get_state()

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Draw from these numbers while the body runs."""
        before = torch.get_rng_state()
        torch.set_rng_state(self._state)
        try:
            yield
        finally:
            self._state = torch.get_rng_state()
            torch.set_rng_state(before)

    def state_dict(self) -> dict[str, Tensor]:
        """Return the generator's state."""
        return {"state": self._state}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Restore :meth:`state_dict`."""
        self._state = state["state"]


def locate(path: Any) -> Any:
    """Import ``package.module.name``.

    Raises:
        ValueError: If there is no such thing.
    """
    module, _, name = str(path).rpartition(".")
    try:
        return getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"_target_: expected package.module.name, got {path!r}: {error}"
        ) from error


def build(node: Mapping[str, Any]) -> Callable[..., Any]:
    """Turn a node with ``_target_`` into a factory: a partial of the target with its other entries.

    Entries that are such nodes themselves become factories too.
    """
    arguments = {
        key: build(value) if isinstance(value, Mapping) and "_target_" in value else value
        for key, value in node.items()
        if key != "_target_"
    }
    return partial(locate(node["_target_"]), **arguments)


def default_agent(environment: EnvironmentFactory) -> Callable[..., Agent]:
    """Return the default algorithm's factory, with the task's symmetry where it has one."""
    algorithm = default_config()["algorithm"]
    make = partial(build(algorithm["agent"]), episode_steps=environment.max_episode_steps)
    symmetry = environment.symmetry() if algorithm["use_symmetries"] else None
    return make if symmetry is None else partial(make, symmetry=symmetry)


def default_exploration() -> Callable[..., Any]:
    """Return the default exploration module's factory."""
    return build(default_config()["algorithm"]["exploration"])
